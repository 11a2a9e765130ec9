"""Put a bench together from its configuration: model, link, limits, references; nothing is energised here."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, load_bench, model_path
from piezod.config.reference import ReferenceConfig
from piezod.control import (
    ControlLoop,
    RateKeeper,
    RealRateKeeper,
    RingLog,
    Segment,
    TableReference,
    VirtualRateKeeper,
    make_reference,
)
from piezod.effects import EFFECTS
from piezod.errors import ConfigurationError, ModelError
from piezod.excitation import triangle_ramp
from piezod.model import (
    DirectDrive,
    ExtendedCompensator,
    Model,
    acting_effects,
    load_model,
    make_compensator,
    refuse_uncompensated,
)
from piezod.transport import (
    Link,
    check_encodable,
    make_link,
    max_wire_rate_Hz,
    verify_identity,
)


@dataclass(frozen=True)
class Work:
    """One stretch of work, as plain values that another process can be given.

    Parameters
    ----------
    name
        For people.
    compensation
        `inverse`, `gain`, or `direct`: then `voltages_V` are driven as they are.
    reference
        What is followed; None: the bench's own.
    voltages_V
        For a direct drive, one a tick [V].
    reset_cycle
        Drive 0 -> voltage_max_V -> 0 first.
    model
        What compensates; None: the session's.
    """

    name: str
    compensation: str
    reference: ReferenceConfig | None = None
    voltages_V: NDArray[np.float64] | None = None
    reset_cycle: bool = True
    model: Model | None = None


def load(path: Path) -> tuple[BenchConfig, Model]:
    """Read and cross-check a bench and its model.

    Raises
    ------
    ConfigurationError
        A file says something impossible, or the wire cannot carry the rate.
    ModelError
        The model has other units, no inverse, or an effect without one.
    """
    bench = load_without_model(path)
    model = load_drivable(model_path(bench, path))
    check_effects(bench, model, path)
    return bench, model


def check_effects(bench: BenchConfig, model: Model, path: Path) -> None:
    """Refuse effects that have no inverse and were not left out, and names in the bench file that are no effect's.

    Parameters
    ----------
    bench, path
        The bench and its file.
    model
        What compensates.

    Raises
    ------
    ConfigurationError
        `compensation_without` names what is not in the catalogue.
    ModelError
        Names the effect, the reason and the remedy.
    """
    for name in bench.compensation_without:
        if name not in EFFECTS:
            raise ConfigurationError(
                f"{path}: compensation_without is {name!r}, must be one of {', '.join(EFFECTS)}; see piezod effects"
            )
    if bench.compensation == "inverse":
        try:
            refuse_uncompensated(acting_effects(model, bench.compensation_without))
        except ModelError as error:
            raise ModelError(f"{model_path(bench, path)}: {error}") from None


def load_drivable(path: Path) -> Model:
    """Read a model that a bench can be driven with: from volts to newtons.

    Raises
    ------
    ConfigurationError
        It cannot be read.
    ModelError
        It has other units, or no inverse.
    """
    model = load_model(path)
    check_units(model, path)
    return model


def check_units(model: Model, path: Path) -> None:
    """Refuse a model of other quantities than a bench commands and measures: its numbers would be taken for volts.

    Raises
    ------
    ModelError
        Names the unit, and the one it must be.
    """
    for place, channel, unit in (("input", model.input, "V"), ("output", model.output, "N")):
        if channel.unit != unit:
            raise ModelError(
                f"{path}: {place}.unit is {channel.unit!r} (column {channel.channel}), must be '{unit}' to drive a "
                f"bench; identify on a column in {unit}"
            )


def load_without_model(path: Path) -> BenchConfig:
    """Read and cross-check a bench that is only to be recorded: its model may not exist yet.

    Raises
    ------
    ConfigurationError
        The file says something impossible, or the wire cannot carry the rate.
    """
    bench = load_bench(path)
    check_wire(bench)
    return bench


def check_wire(bench: BenchConfig) -> None:
    """Refuse a rate above what the wire can carry, and voltages that it cannot encode.

    Raises
    ------
    ConfigurationError
        Names the rate and the wire's floor, or the voltage and what its register carries.
    """
    check_encodable(bench.link, bench.limits.voltage_min_V, bench.limits.voltage_max_V)
    for name, link in (("link", bench.link), ("load_cell_link", bench.load_cell_link)):
        floor_Hz = None if link is None else max_wire_rate_Hz(link)
        if floor_Hz is not None and bench.rate_Hz > floor_Hz:
            raise ConfigurationError(
                f"rate_Hz is {bench.rate_Hz:g}, must be at most {floor_Hz:.0f}: more exchanges a second do not fit the "
                f"wire of {name}; lower rate_Hz or raise {name}.baudrate"
            )


@contextlib.contextmanager
def opened_link(bench: BenchConfig) -> Iterator[Link]:
    """The link, connected and its device identified; closed at the end.

    Raises
    ------
    UnreachableError, BusyError
        Nobody answers, or somebody else holds the device.
    IdentityError
        Another device, map or byte order than configured.
    """
    link = make_link(bench.link, bench.load_cell_link)
    link.open()
    try:
        verify_identity(link)
        yield link
    finally:
        link.close()


def make_rate_keeper(bench: BenchConfig, link: Link) -> RateKeeper:
    """The clock of this bench: the machine's, or the emulator's own where its time is virtual."""
    if link.has("virtual_time") and link.read_register("virtual_time") == 1:
        link.write_register("virtual_tick_us", round(1e6 * bench.dt_s))
        return VirtualRateKeeper(bench.dt_s)
    return RealRateKeeper(bench.dt_s)


def make_segment(work: Work, bench: BenchConfig, model: Model | None, link: Link, folder: Path) -> Segment:
    """Turn work into what the loop drives.

    Raises
    ------
    ConfigurationError
        The reference cannot be had, or the model has no inverse.
    """
    reset_cycle = _reset_cycle(bench) if work.reset_cycle else None
    if work.voltages_V is not None:
        return Segment(work.name, TableReference(work.voltages_V), DirectDrive(), reset_cycle, follows_force=False)
    if (model := work.model or model) is None:
        raise ConfigurationError(f"{work.name}: compensation '{work.compensation}' needs a model, none was loaded")
    config = work.reference or bench.reference
    counted = link.has("reference_counter")
    reference = make_reference(config, bench.rate_Hz, folder, link.reading, counted=counted)
    compensator = make_compensator(work.compensation, model, bench.dt_s, bench.compensation_without)
    if not isinstance(compensator, ExtendedCompensator):
        return Segment(work.name, reference, compensator, reset_cycle)
    if isinstance(reference, TableReference):
        reference.plan_ahead(compensator.ahead, compensator.preview_ticks)
    return Segment(work.name, reference, compensator, reset_cycle, update_temperature=compensator.update_temperature)


def _reset_cycle(bench: BenchConfig) -> TableReference:
    """Safe voltage -> highest -> safe, at the arming slew."""
    low, high = bench.limits.voltage_safe_V, bench.limits.voltage_max_V
    ticks = max(2, round(2 * (high - low) / bench.arming.voltage_V_per_s * bench.rate_Hz))
    return TableReference(low + (high - low) * triangle_ramp(np.arange(ticks + 1) / ticks))


def make_loop(bench: BenchConfig, link: Link, clock: RateKeeper, ring: RingLog) -> ControlLoop:
    """The loop of this bench, disarmed."""
    arming = bench.arming
    return ControlLoop(
        link,
        bench.limits,
        clock,
        ring,
        bench.dt_s,
        arming.voltage_V_per_s,
        sign_check=None if "sign_check" in arming.without else arming.sign_check,
        readback_within_V=arming.readback_within_V,
        watchdog_in_status=link.has("status"),
    )


__all__ = [
    "Work",
    "check_effects",
    "check_units",
    "load",
    "load_drivable",
    "load_without_model",
    "make_loop",
    "make_rate_keeper",
    "make_segment",
    "opened_link",
]
