"""Coverage of a proof test: which configured trips of a bench it has proven, and why it has not proven the others."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from piezod.config import BenchConfig


@dataclass(frozen=True)
class Trip:
    """One trip of the interlocks.

    Parameters
    ----------
    key
        Key of the bench file that configures it, without `limits.`.
    step
        Step of the proof test that provokes it; empty: none does.
    reason
        Why no step provokes it; empty with a step.
    """

    key: str
    step: str
    reason: str = ""


TRIPS = (
    Trip("force_trip_N", "force"),
    Trip("force_min_N", "minimum"),
    Trip("force_rate_trip_N_per_s", "rate"),
    Trip("tracking_trip_N", "tracking"),
    Trip("stuck_samples", "stuck"),
    Trip("readback_trip_V", "readback"),
    Trip("dissipation_max_W", "heat"),
    Trip("temperature_trip_degC", "temperature"),
    Trip("temperature_low_degC", "thermometer"),
    Trip("temperature_frozen_s", "", "takes minutes at rest: remove the sensor while driving"),
    Trip("stale_after_ms", "stale"),
    Trip("comm_loss_ms", "silence"),
    Trip("failed_exchanges", "exchanges"),
    Trip("missed_ticks_in_a_row", "missed"),
    Trip("output_on_in_status", "output"),
    Trip("clamped_trip_ms", "clamp"),
    Trip("device_watchdog_ms", "watchdog"),
    Trip("arming_timeout_s", "", "needs a reference that never arrives: arm without its sender"),
    Trip("arming.sign_check", "level"),
    Trip("link.registers.status", "amplifier"),
    Trip("link.registers.identity", "", "needs another device: it is compared at each connection"),
    Trip("link.registers.command_echo", "", "needs a second master: write from another client while driving"),
)

_BY_DEFAULT = {"failed_exchanges"}  # null is a number of its own, never off
_CONFIGURED: dict[str, Callable[[BenchConfig], bool]] = {
    "arming.sign_check": lambda bench: "sign_check" not in bench.arming.without,
    "temperature_low_degC": lambda bench: bench.limits.temperature_trip_degC is not None,
}


def _is_configured(trip: Trip, bench: BenchConfig) -> bool:
    """Whether the bench file switches this trip on."""
    if (known := _CONFIGURED.get(trip.key)) is not None:
        return known(bench)
    if trip.key.startswith("link.registers."):
        return bench.has_role(trip.key.rpartition(".")[2])
    return trip.key in _BY_DEFAULT or bool(getattr(bench.limits, trip.key) not in (None, False, 0))


def coverage(bench: BenchConfig, results: Mapping[str, str]) -> dict[str, Any]:
    """Coverage as the record holds it.

    Parameters
    ----------
    results
        Result of each step that was done, by its name.

    Returns
    -------
    dict
        Number of configured and of proven trips, a sentence, and a reason for each configured trip without a proof.
    """
    configured = [trip for trip in TRIPS if _is_configured(trip, bench)]
    reasons = {trip.key: _reason(trip, results) for trip in configured}
    missing = {key: reason for key, reason in reasons.items() if reason}
    proven = len(configured) - len(missing)
    return {
        "configured": len(configured),
        "proven": proven,
        "text": f"coverage: {proven} of {len(configured)} configured trips proven",
        "not_proven": missing,
    }


def _reason(trip: Trip, results: Mapping[str, str]) -> str:
    """Why a configured trip is not proven; empty: it is."""
    if not trip.step:
        return trip.reason
    result = results.get(trip.step, "not done")
    return "" if result == "pass" else f"step {trip.step}: {result}"
