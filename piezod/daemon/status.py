"""The status of the daemon: as the JSON object that its socket sends, and as the text of `piezod status`."""

from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piezod import __version__
from piezod.config import BenchConfig
from piezod.config.reference import RegisterReference, StreamReference
from piezod.control.leaky_count import interlock_counts
from piezod.control.references import counts_dict
from piezod.daemon.journal import JOURNAL
from piezod.daemon.last_check import check_text
from piezod.daemon.proof_date import proof_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from piezod.daemon.command_channel import CommandChannel
    from piezod.daemon.last_check import LastCheck
    from piezod.daemon.model_watch import ModelWatch
    from piezod.daemon.phase_watch import PhaseWatch
    from piezod.daemon.proof_date import ProofDate
    from piezod.daemon.railed import RailedWatch
    from piezod.daemon.statistics import TickStatistics
    from piezod.recorder.watch import RecorderWatch

_VALUES = (
    ("force_N", "N"),
    ("reference_N", "N"),
    ("voltage_V", "V"),
    ("readback_V", "V"),
    ("temperature_C", "degC"),
)


def status_dict(
    bench: BenchConfig,
    path: Path,
    channel: "CommandChannel",
    statistics: "TickStatistics",
    recorder: "RecorderWatch | None",
    model_watch: "ModelWatch",
    railed_watch: "RailedWatch",
    phase_watch: "PhaseWatch",
    proof: "ProofDate | None",
    last_check: "LastCheck",
    up_s: float,
) -> dict[str, object]:
    """Make the status; runs in the daemon.

    Parameters
    ----------
    channel
        Connection to the control process.
    recorder
        Recorder; None without one.
    railed_watch
        Watch for a reference out of reach.
    phase_watch
        Durations of the phases of a tick.
    proof
        Last proof test; None: it is not watched.
    last_check
        Last check of the model with a recorded drive.
    up_s
        Time since the start of the daemon [s].
    """
    drift, preview, age_s = model_watch.drift, model_watch.preview, statistics.age.age_s
    stale = statistics.age.is_stale(bench.dt_s)
    silent = "no good exchange with the device; check cable and device" if channel.connected and stale else ""
    return {
        "schema": "piezod.status/1",
        "version": __version__,
        "bench": bench.name,
        "config": str(path.resolve()),
        "model": None if bench.model is None else str(bench.model),
        "rate_Hz": bench.rate_Hz,
        "connected": channel.connected and not stale,
        "problem": channel.problem or silent,
        "up_s": round(up_s, 3),
        "age_s": None if age_s is None else round(age_s, 3),
        "stale": stale,
        "log_lines_dropped": JOURNAL.dropped,
        "rows_dropped": 0 if channel.session is None else channel.session.dropped,
        "reference_values": reference_values(bench, channel),
        "interlocks": interlock_counts(channel.counters),
        "recorder": None if recorder is None else recorder.as_dict(),
        "drift": None if drift is None else drift.as_dict(),
        "learning": None if model_watch.learning is None else model_watch.learning.as_dict(),
        "rail": railed_watch.as_dict(),
        "proof": None if proof is None else proof.as_dict(),
        "check": last_check.as_dict(),
        "phases": phase_watch.as_dict(),
        "bad_exchange": channel.bad_exchange,
        "preview": None if preview is None else preview.as_dict(),
        "corrected_force_N": None if drift is None else drift.corrected(),
        **statistics.as_dict(),
    }


def reference_values(bench: BenchConfig, channel: "CommandChannel") -> dict[str, int] | None:
    """Count the values of a live reference by the result of their check; None for a reference that is known ahead.

    Parameters
    ----------
    channel
        Connection to the control process.
    """
    if not isinstance(bench.reference, (RegisterReference, StreamReference)):
        return None
    return counts_dict(channel.counters)


def status_text(status: dict[str, Any]) -> str:
    """Make the lines of `piezod status`; runs in the client.

    Parameters
    ----------
    status
        Status as `status_dict` makes it.
    """
    lines = [f"{status['bench']}: {_state_text(status)}"]
    if status["problem"]:
        lines.append(f"  {status['problem']}")
    known = [
        f"{name.rpartition('_')[0]} {status[name]:.2f} {unit}" for name, unit in _VALUES if status[name] is not None
    ]
    if known:
        lines.append("  " + ", ".join(known))
    lines.append(
        f"  {status['ticks']} ticks at {status['rate_Hz']:g} Hz, {missed_text(status)} missed, "
        f"{status['failed_exchanges']} failed exchanges; up {status['up_s']:.0f} s"
    )
    if status.get("corrected_force_N") is not None and status["force_N"] is not None:
        corrected = f"corrected for the load cell {status['corrected_force_N']:.2f} N"
        lines.append(f"  {corrected}; limits apply to the uncorrected reading")
    sections: dict[str, Callable[[Any], str]] = {
        "reference_values": _values_text,
        "interlocks": _counts_text,
        "drift": _drift_text,
        "learning": _learning_text,
        "rail": _rail_text,
        "proof": proof_text,
        "check": check_text,
        "recorder": _recorder_text,
    }
    texts = [text_of(status[name]) for name, text_of in sections.items() if status.get(name)]
    lines += [f"  {text}" for text in texts if text]
    return "\n".join(lines)


def _rail_text(rail: dict[str, Any]) -> str:
    lasted = f"reference: RAILED; not reachable, the voltage is at a limit for {rail['lasted_s']:.1f} s"
    return lasted if rail["railed"] else ""


def missed_text(status: dict[str, Any]) -> str:
    """Number of missed ticks, with their share of the ticks that were due.

    Parameters
    ----------
    status
        Status as `status_dict` makes it.
    """
    missed, due = status["missed"], status["missed"] + status["ticks"]
    return f"{missed} ({100.0 * missed / due:.2g} %)" if missed else "0"


def _state_text(status: dict[str, Any]) -> str:
    if status.get("stale") and status["age_s"] is not None:
        return f"STALE, the values are {status['age_s']:.1f} s old; then {status['state']}"
    return f"{status['state']}, {status['cause']}"


def _values_text(values: dict[str, int]) -> str:
    refused = {name: count for name, count in values.items() if count and name != "accepted"}
    reasons = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in refused.items())
    return f"reference: {values['accepted']} values accepted, {sum(refused.values())} refused" + (
        f" ({reasons})" if reasons else ""
    )


def _counts_text(interlocks: dict[str, dict[str, float]]) -> str:
    """Leaky counts of the interlocks that saw a wrong sample; empty where none did."""
    seen = ", ".join(
        f"{name.replace('_', ' ')} {count['wrong']:.0f} ({100 * count['level']:.0f} %, {100 * count['highest']:.0f} %)"
        for name, count in interlocks.items()
        if count["wrong"]
    )
    return f"interlocks, wrong samples (share of a trip now, highest since arming): {seen}" if seen else ""


def _learning_text(learning: dict[str, Any]) -> str:
    if learning["rms_N"] is None:
        return "learning: waits for the first repeat"
    text = f"error {learning['first_N']:.3g} N at first, {learning['rms_N']:.3g} N in pass {learning['passes']}"
    state = "" if learning["state"] == "learning" else f"{learning['state']}; "
    return f"learning: {state}{text}" + (f"; not kept: {learning['problem']}" if learning["problem"] else "")


def _drift_text(drift: dict[str, Any]) -> str:
    if drift["rms_N"] is None:
        return f"model: nothing compared yet, limit {drift['limit_N']:.2f} N"
    whole_N = hypot(drift["rms_N"], drift["offset_N"])  # `rms_N` is about the mean
    found = f"{whole_N:.2f} N rms, {drift['offset_N']:+.2f} N in the mean"
    problem = f" ({drift['problem']})" if drift["problem"] else ""
    if drift["drifted"]:
        return f"model: DRIFTED; {found}; recorded in {drift['kept']}{problem}; see piezod diagnose --from-bench"
    if drift["outside"]:
        return f"model: another input, not compared; {found}; {drift['outside']}{problem}"
    known = (
        f"first stretch of driving, limit {drift['limit_N']:.2f} N"
        if drift["first_stretch"]
        else f"compared with {drift['known_windows']} windows of driving"
    )
    evidence = f"evidence of a change {drift['evidence']:.2g}, alarm at {drift['alarm_at']:.2g}"
    return f"model: holds; {found}; {known}; {evidence}{problem}"


def _recorder_text(recorder: dict[str, Any]) -> str:
    lost = f", {recorder['dropped']} lost" if recorder["dropped"] else ""
    if recorder["degraded"]:
        return f"recorder DEGRADED: {recorder['problem']}; {recorder['rows']} ticks recorded{lost}"
    return f"recorded {recorder['rows']} ticks{lost}; {recorder['file'] or 'no file yet'}"
