"""Force and voltage that a reference will ask for, and the ways of a stop, computed before the bench is driven."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.check_result import Check
from piezod.config import BenchConfig
from piezod.config.reference import RegisterReference, StreamReference
from piezod.control import TableReference
from piezod.errors import PiezodError
from piezod.model import Model, make_compensator, steady_range
from piezod.session.assembly import plan_ahead, reference_table
from piezod.session.session import END_WITHIN_S

MOST_PLANNED = 500_000  # Ticks whose voltage is computed. They take 2 s; a longer reference is described by its begin


def check_reference(bench: BenchConfig, model: Model, folder: Path) -> Iterator[Check]:
    """Check the forces and voltages of a reference that is known ahead; a live reference has no known values.

    Parameters
    ----------
    folder
        Folder that relative paths start from.
    """
    if isinstance(bench.reference, (RegisterReference, StreamReference)):
        return
    try:
        table = reference_table(bench, folder)
        force_N = table.values()
        voltage_V = _planned_voltage_V(bench, model, table)
    except PiezodError as error:
        yield Check("reference", "FAIL", str(error))
        return
    yield _force_check(bench, model, force_N, loops=table.loops)
    yield _voltage_check(bench, force_N, voltage_V)


def check_distances(bench: BenchConfig, model: Model) -> Iterator[Check]:
    """Check the way that the output still rises at most after a stop and after a force trip, and the time to rest.

    A stop acts at the next tick. Between two ticks the force may pass its trip, so that a trip acts a tick later. The
    debounce of a trip takes time; the output falls meanwhile.
    """
    limits, dt_s, slew = bench.limits, bench.dt_s, bench.limits.slew_V_per_s
    voltage_V = np.interp(np.arange(401), (0, 200, 400), (model.input.low, model.input.high, model.input.low))
    slope = float(np.abs(np.diff(model.operator().run(voltage_V)) / np.diff(voltage_V)).max())
    span_V = limits.voltage_max_V - limits.voltage_safe_V
    fall_s = limits.braking_s * (1.0 + limits.fall_V_per_s / slew)
    for name, ticks, debounce in (("stop", 1, 0), ("trip", 2, limits.force_debounce_samples - 1)):
        way_V = slew * (ticks * dt_s + 0.5 * limits.braking_s)
        rest_s = (ticks + debounce) * dt_s + fall_s + (span_V + way_V) / limits.fall_V_per_s
        finding = f"at most {way_V:.3g} V and {slope * way_V:.3g} N further, then {limits.voltage_safe_V:g} V"
        finding += f" within {1e3 * rest_s:.3g} ms, at limits.slew_V_per_s and deceleration_V_per_s2"
        force_N, remedy = limits.force_trip_N - limits.force_min_N, ""
        if way_V > span_V or slope * way_V > force_N or rest_s > END_WITHIN_S:
            finding += f"; must be at most {span_V:g} V, {force_N:g} N and {1e3 * END_WITHIN_S:g} ms"
            remedy = "raise limits.deceleration_V_per_s2, or change slew_V_per_s"
        yield Check(name, "FAIL" if remedy else "OK", finding, remedy)


def _planned_voltage_V(bench: BenchConfig, model: Model, table: TableReference) -> NDArray[np.float64]:
    """Voltage that the compensation plans in each tick, from the model's start state [V].

    A loop is passed twice: the first pass begins without the memory of a pass before. The states advance with the
    voltage within the limits; without the slew limit. At most `MOST_PLANNED` ticks. Afterwards the values of the table
    are led by delay and resonance.
    """
    compensator = make_compensator(bench.compensation, model, bench.dt_s, bench.compensation_without)
    plan_ahead(table, compensator)
    compensator.reset()
    low_V, high_V = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    planned_N = table.planned()[:MOST_PLANNED]
    ahead_N = np.tile(planned_N, 2 if table.loops else 1)[:MOST_PLANNED].tolist()
    planned_V = np.empty(len(ahead_N))
    for k, force_N in enumerate(ahead_N):
        planned_V[k] = compensator.plan(force_N)
        compensator.commit(min(max(float(planned_V[k]), low_V), high_V))
    return planned_V


def _force_check(bench: BenchConfig, model: Model, force_N: NDArray[np.float64], *, loops: bool) -> Check:
    """Range, ends, largest rate and length of the force, against the reach of the model."""
    bottom, top = steady_range(model)
    ticks = f"{force_N.size} ticks, {force_N.size / bench.rate_Hz:.10g} s{', repeated' if loops else ''}"
    finding = f"{_course(force_N, bench.rate_Hz, 'N', loops=loops)}, {ticks}"
    if force_N.min() < bottom or force_N.max() > top:
        remedy = f"after a reset cycle {bottom:.1f} to {top:.1f} N can be reached; beyond, the voltage is clamped"
        return Check("reference", "WARN", finding, remedy)
    return Check("reference", "OK", finding)


def _voltage_check(bench: BenchConfig, force_N: NDArray[np.float64], voltage_V: NDArray[np.float64]) -> Check:
    """Range, ends and largest rate of the planned voltage, against the limits; the way of a stop against the trip."""
    limits = bench.limits
    finding = _course(voltage_V, bench.rate_Hz, "V", loops=False)
    if (highest_N := _highest_with_braking_N(bench, force_N, voltage_V)) > limits.force_trip_N:
        finding += f", {highest_N:.6g} N with the way of a stop, must be at most force_trip_N, {limits.force_trip_N:g}"
        return Check("voltage", "FAIL", finding, "raise limits.deceleration_V_per_s2, or lower the rate")
    if voltage_V.size < force_N.size:
        finding += f", of the first {voltage_V.size} ticks"
    if not (limits.voltage_min_V <= voltage_V.min() and voltage_V.max() <= limits.voltage_max_V):
        remedy = f"is clamped to {limits.voltage_min_V:g} to {limits.voltage_max_V:g} V (limits)"
        return Check("voltage", "WARN", finding, remedy)
    if _largest_rate(voltage_V, bench.rate_Hz, loops=False) > limits.slew_V_per_s * (1.0 + 1e-9):
        return Check("voltage", "WARN", finding, f"limits.slew_V_per_s, {limits.slew_V_per_s:g}, makes it slower")
    return Check("voltage", "OK", finding)


def _highest_with_braking_N(bench: BenchConfig, force_N: NDArray[np.float64], voltage_V: NDArray[np.float64]) -> float:
    """Highest force that the force interlock sees: it counts the way that the output rises after a stop [N]."""
    if bench.limits.deceleration_V_per_s2 is None or min(force_N.size, voltage_V.size) < 2:
        return -np.inf
    rate_V = np.diff(voltage_V[: force_N.size]).clip(0.0, bench.limits.slew_V_per_s * bench.dt_s) * bench.rate_Hz
    rate_N = np.diff(force_N[: voltage_V.size]).clip(0.0) * bench.rate_Hz
    return float((force_N[1 : rate_N.size + 1] + 0.5 * rate_N * rate_V / bench.limits.deceleration_V_per_s2).max())


def _course(values: NDArray[np.float64], rate_Hz: float, unit: str, *, loops: bool) -> str:
    """Range, first and last value, and largest rate of a curve, as text."""
    rate = _largest_rate(values, rate_Hz, loops=loops)
    return (
        f"{values.min():.6g} to {values.max():.6g} {unit}, first {values[0]:.6g}, last {values[-1]:.6g}, "
        f"at most {rate:.4g} {unit}/s"
    )


def _largest_rate(values: NDArray[np.float64], rate_Hz: float, *, loops: bool) -> float:
    """Largest rate between two ticks [1/s]; in a loop also from the last to the first."""
    steps = np.diff(values, append=values[:1]) if loops else np.diff(values)
    return float(np.abs(steps).max(initial=0.0)) * rate_Hz
