"""Build the parts of a session from the bench configuration: model, link, clock, segments, loop.

Nothing in this module energises the bench.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from piezod.config import BenchConfig, load_bench, model_path
from piezod.control import (
    ControlLoop,
    PhaseTimes,
    RateKeeper,
    RealRateKeeper,
    Reference,
    RingLog,
    Segment,
    TableReference,
    VirtualRateKeeper,
    make_reference,
)
from piezod.control.references.repeat_correction import correction_cells
from piezod.effects import EFFECTS
from piezod.errors import ConfigurationError, ModelError
from piezod.excitation import triangle_ramp
from piezod.model import (
    Compensator,
    DirectDrive,
    ExtendedCompensator,
    Model,
    acting_effects,
    load_model,
    make_compensator,
    refuse_uncompensated,
)
from piezod.model.reach import LEAST_REACHED, MOST_BEYOND, beyond_measured, output_reach, reached_share
from piezod.model.unnamed_law import NAME as UNNAMED
from piezod.session.task import SegmentSpec
from piezod.transport import (
    Link,
    Reading,
    check_encodable,
    make_link,
    max_wire_rate_Hz,
    verify_identity,
)

MOST_LEARNED_TICKS = 2_000_000
"""Longest repeat that is learned [ticks]: its spectra take 0.5 GB in the daemon, and half a second of one core."""


def load_bench_and_model(path: Path) -> tuple[BenchConfig, Model]:
    """Read a bench configuration and its model, and check that they fit together.

    Raises
    ------
    ConfigurationError
        A value is invalid, or the wire cannot carry the rate.
    ModelError
        The model has other units, no inverse, or an effect without an inverse.
    """
    bench = load_bench_without_model(path)
    model = load_drivable_model(model_path(bench, path))
    check_effects(bench, model, path)
    return bench, model


def load_bench_without_model(path: Path) -> BenchConfig:
    """Read a bench configuration whose model may not exist yet, and check it against the wire.

    Raises
    ------
    ConfigurationError
        A value is invalid, or the wire cannot carry the rate.
    """
    bench = load_bench(path)
    check_wire(bench)
    return bench


def load_drivable_model(path: Path) -> Model:
    """Read a model that can drive a bench: its input is in volts, its output in newtons.

    Raises
    ------
    ConfigurationError
        The file cannot be read.
    ModelError
        The model has other units or no inverse, or its forces leave the measured range.
    """
    model = load_model(path)
    check_units(model, path)
    if (beyond := beyond_measured(model)) > MOST_BEYOND:
        least, largest = output_reach(model)
        raise ModelError(
            f"{path}: forces go from {least:.4g} to {largest:.4g} {model.output.unit} within the range of the input, "
            f"{100.0 * beyond:.0f} % beyond those measured ({model.output.low:.4g} to {model.output.high:.4g}), "
            f"may be {100.0 * MOST_BEYOND:.0f} %; record over the whole range and identify again"
        )
    if (reached := reached_share(model)) < LEAST_REACHED:
        raise ModelError(
            f"{path}: its forces span {100.0 * reached:.0f} % of those measured ({model.output.low:.4g} to "
            f"{model.output.high:.4g} {model.output.unit}), must be at least {100.0 * LEAST_REACHED:.0f} %; the "
            "file was changed, or belongs to another bench: identify again"
        )
    return model


def check_units(model: Model, path: Path) -> None:
    """Refuse a model of other quantities: its numbers would be written as volts.

    Raises
    ------
    ModelError
        Names the unit and the required unit.
    """
    for place, channel, unit in (("input", model.input, "V"), ("output", model.output, "N")):
        if channel.unit != unit:
            raise ModelError(
                f"{path}: {place}.unit is {channel.unit!r} (column {channel.channel}), must be '{unit}' to drive a "
                f"bench; identify on a column in {unit}"
            )
        if channel.channel.startswith("-"):
            raise ModelError(
                f"{path}: {place}.channel is {channel.channel}, its readings fall where the voltage rises; turn the "
                "sign of the load cell (registers.force.scale), record and identify again"
            )


def check_effects(bench: BenchConfig, model: Model, path: Path) -> None:
    """Refuse effects of the model that have no inverse and are not excluded by `compensation_without`.

    Raises
    ------
    ConfigurationError
        `compensation_without` contains a name that is not in the catalogue of effects.
    ModelError
        Names the effect, the reason and the remedy.
    """
    for name in bench.compensation_without:
        if name not in (*EFFECTS, UNNAMED):
            names = ", ".join((*EFFECTS, UNNAMED))
            raise ConfigurationError(
                f"{path}: compensation_without is {name!r}, must be one of {names}; see piezod effects"
            )
    if bench.compensation == "inverse":
        try:
            refuse_uncompensated(acting_effects(model, bench.compensation_without))
        except ModelError as error:
            raise ModelError(f"{model_path(bench, path)}: {error}") from None


def check_wire(bench: BenchConfig) -> None:
    """Refuse a rate above the wire's limit, and voltages that the wire cannot encode.

    Raises
    ------
    ConfigurationError
        Names the rate and its limit, or the voltage and the range of its register.
    """
    check_encodable(bench.link, bench.limits.voltage_min_V, bench.limits.voltage_max_V)
    for name, link in (("link", bench.link), ("load_cell_link", bench.load_cell_link)):
        highest_Hz = None if link is None else max_wire_rate_Hz(link)
        if highest_Hz is not None and bench.rate_Hz > highest_Hz:
            raise ConfigurationError(
                f"rate_Hz is {bench.rate_Hz:g}, must be at most {highest_Hz:.0f}: the wire of {name} does not carry "
                f"more exchanges per second; lower rate_Hz or raise {name}.baudrate"
            )


@contextlib.contextmanager
def opened_link(bench: BenchConfig, bad_exchange: Any = None) -> Iterator[Link]:  # noqa: ANN401  # any object with the buffer protocol
    """Connect the link and verify the identity of its device; close the link at the end.

    Parameters
    ----------
    bad_exchange
        Memory for the bytes of failed exchanges (`transport/bad_exchange.py`); None: memory of this process.

    Raises
    ------
    UnreachableError, BusyError
        No device answers, or another program holds the device.
    IdentityError
        Device, register map or byte order differ from the configuration.
    """
    link = make_link(bench.link, bench.load_cell_link)
    if bad_exchange is not None:
        link.keep_bad_exchange_in(bad_exchange)
    link.open()
    try:
        verify_identity(link)
        yield link
    finally:
        link.close()


def make_rate_keeper(bench: BenchConfig, link: Link) -> RateKeeper:
    """Make the clock of the ticks: the monotonic clock, or the clock of an emulator in virtual time."""
    if link.has("virtual_time") and link.read_register("virtual_time") == 1:
        link.write_register("virtual_tick_us", round(1e6 * bench.dt_s))
        return VirtualRateKeeper(bench.dt_s)
    return RealRateKeeper(bench.dt_s)


def reference_table(bench: BenchConfig, folder: Path) -> TableReference:
    """Make the table of a reference that is known ahead.

    Parameters
    ----------
    bench
        Bench configuration with a waveform or a file for a reference.
    folder
        Folder that relative paths start from.

    Raises
    ------
    ConfigurationError
        The file cannot be read or holds a value beyond the range, or the waveform does not fit the tick rate.
    """
    reference = make_reference(bench.reference, bench.rate_Hz, folder, Reading(), bench.reference_range, counted=False)
    assert isinstance(reference, TableReference)
    return reference


def correction_size(bench: BenchConfig, folder: Path) -> int:
    """Number of float64 values of a learned correction (`RepeatCorrection`); 0: no learned correction.

    Parameters
    ----------
    folder
        Folder that relative paths start from.

    Raises
    ------
    ConfigurationError
        The reference cannot be made, or a repeat has more than `MOST_LEARNED_TICKS`.
    """
    if bench.learning is None:
        return 0
    ticks = len(reference_table(bench, folder))
    if ticks > MOST_LEARNED_TICKS:
        raise ConfigurationError(
            f"learning: a repeat of the reference has {ticks} ticks, must have at most {MOST_LEARNED_TICKS}; shorten "
            "it, or write learning: null"
        )
    return correction_cells(ticks)


def plan_ahead(reference: Reference, compensator: Compensator) -> None:
    """Let the values of a table lead by delay and resonance of the model; no effect on any other reference."""
    if isinstance(reference, TableReference) and isinstance(compensator, ExtendedCompensator):
        reference.plan_ahead(compensator.ahead, compensator.preview_ticks)


def make_segment(spec: SegmentSpec, bench: BenchConfig, model: Model | None, link: Link, folder: Path) -> Segment:
    """Make the segment that a specification describes.

    Parameters
    ----------
    bench
        Bench configuration; its reference is used where `spec` has none.
    model
        Model that is used where `spec` has none.
    link
        Opened link; a reference in registers is read through it.
    folder
        Folder that relative paths start from.

    Raises
    ------
    ConfigurationError
        The reference cannot be opened, or a compensation has no model.
    ModelError
        The model has no inverse.
    """
    reset_cycle = _reset_cycle(bench) if spec.reset_cycle else None
    if spec.voltages_V is not None:
        return Segment(spec.name, TableReference(spec.voltages_V), DirectDrive(), reset_cycle, follows_force=False)
    if (model := spec.model or model) is None:
        raise ConfigurationError(f"{spec.name}: compensation '{spec.compensation}' needs a model, none was loaded")
    config = spec.reference or bench.reference
    counted = link.has("reference_counter")
    reference = make_reference(config, bench.rate_Hz, folder, link.reading, bench.reference_range, counted=counted)
    compensator = make_compensator(spec.compensation, model, bench.dt_s, bench.compensation_without)
    plan_ahead(reference, compensator)
    if not isinstance(compensator, ExtendedCompensator):
        return Segment(spec.name, reference, compensator, reset_cycle)
    return Segment(spec.name, reference, compensator, reset_cycle, update_temperature=compensator.update_temperature)


def _reset_cycle(bench: BenchConfig) -> TableReference:
    """Voltages safe -> highest -> safe, at the slew rate of arming."""
    low, high = bench.limits.voltage_safe_V, bench.limits.voltage_max_V
    ticks = max(2, round(2 * (high - low) / bench.arming.voltage_V_per_s * bench.rate_Hz))
    return TableReference(low + (high - low) * triangle_ramp(np.arange(ticks + 1) / ticks))


def make_loop(
    bench: BenchConfig, link: Link, clock: RateKeeper, ring_log: RingLog, phases: PhaseTimes | None = None
) -> ControlLoop:
    """Make the control loop of a bench, disarmed.

    Parameters
    ----------
    ring_log
        Ring log that every tick is written to.
    phases
        Times of the phases of a tick; None: not measured.
    """
    arming = bench.arming
    return ControlLoop(
        link,
        bench.limits,
        clock,
        ring_log,
        bench.dt_s,
        arming.voltage_V_per_s,
        sign_check=None if "sign_check" in arming.without else arming.sign_check,
        readback_within_V=arming.readback_within_V,
        watchdog_in_status=link.has("status"),
        phases=phases,
    )
