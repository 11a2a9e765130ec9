"""Foreign effects: they are in no catalogue. A diagnosis must flag them and must not name a catalogue effect instead.

Each acts at one location in the chain and grows with one `amount`. At `reading` it acts on the samples, elsewhere on
the fine grid. All are derived here. No catalogue effect reproduces them, because they depend on one of these:

- a product of drive and time;
- the path travelled;
- the history of the load;
- a clock of their own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.linear import first_order, respond


@dataclass(frozen=True)
class ForeignContext:
    """What a foreign effect reads besides its input signal.

    Parameters
    ----------
    drive
        Commands of the record.
    dt_s
        Step of the grid of the signal [s].
    reach_V, full_N
        Ranges of voltage [V] and force [N].
    rng
        Random numbers of this effect in this record.
    """

    drive: Drive
    dt_s: float
    reach_V: float
    full_N: float
    rng: np.random.Generator


Details = Mapping[str, object]
Apply = Callable[[Array, float, Details, ForeignContext], Array]


@dataclass(frozen=True)
class Foreign:
    """One foreign effect.

    Parameters
    ----------
    location
        Location in the chain: `amplifier`, `stack`, `force` or `reading`.
    apply
        Returns the signal with the effect: (signal, amount, details, context).
    least, most
        Range of the amount (1), or [s] where the amount is a time.
    details
        Draws the other parameters.
    """

    location: str
    apply: Apply
    least: float
    most: float
    details: Callable[[np.random.Generator], dict[str, object]]


def _number(details: Details, name: str) -> float:
    value = details[name]
    assert isinstance(value, (int, float))
    return float(value)


def _ratcheting_mount(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """The mount yields while the force is high, and recovers slowly afterwards."""
    load = np.maximum(force_N / context.full_N - _number(details, "yield_share"), 0.0) ** 1.5
    slip = _leaking_sum(load * context.dt_s, np.exp(-context.dt_s / _number(details, "recovery_s")))
    return force_N - amount * context.full_N * slip


def _growing_backlash(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """A worn joint: its play widens with the path travelled."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(force_N))))) / context.full_N
    width_N = amount * context.full_N * (path / _number(details, "path")) ** 0.7
    return _widening_play(force_N, width_N)


def _emi_tare_knocks(reading_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """Electromagnetic bursts shift the tare; an auto-zero returns it slowly."""
    knocks = np.zeros(reading_N.size)
    count = max(6, int(_number(details, "per_minute") * context.drive.time_s[-1] / 60.0))
    where = context.rng.integers(0, reading_N.size, count)
    np.add.at(knocks, where, context.rng.normal(0.0, 1.0, count))
    return reading_N + amount * context.full_N * _leaking_sum(
        knocks, np.exp(-context.dt_s / _number(details, "auto_zero_s"))
    )


def _thermostat_gain(stroke: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """A heater switches with its own period; the gain follows its saw-tooth."""
    phase = np.arange(stroke.size) * context.dt_s / _number(details, "period_s") + context.rng.uniform()
    duty = _number(details, "duty")
    part = phase % 1.0
    saw_tooth = np.where(part < duty, part / duty, (1.0 - part) / (1.0 - duty))
    return stroke * (1.0 + amount * (saw_tooth - 0.5))


def _softening_memory(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """The stiffness is lower below the highest recent force (Mullins effect); this memory fades."""
    highest_N = _fading_peak(force_N, float(np.exp(-context.dt_s / _number(details, "memory_s"))))
    below = np.clip(1.0 - force_N / np.maximum(highest_N, 1e-6 * context.full_N), 0.0, 1.0)
    return force_N * (1.0 - amount * below)


def _swapped_buffers(reading_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """Neighbouring buffers of readings arrive in the wrong order; `amount` is the share of swapped pairs."""
    size = max(4, round(_number(details, "buffer_s") / context.dt_s))
    result = reading_N.copy()
    chance = context.rng.uniform(size=reading_N.size // (2 * size))
    for pair in np.flatnonzero(chance < amount):
        start, middle, end = 2 * pair * size, (2 * pair + 1) * size, (2 * pair + 2) * size
        result[start:end] = np.concatenate((reading_N[middle:end], reading_N[start:middle]))
    return result


def _drive_intermodulation(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """A tone whose amplitude follows the distance of the force from half range: side bands without a line."""
    time_s = np.arange(force_N.size) * context.dt_s
    wave = np.sin(2.0 * np.pi * _number(details, "frequency_Hz") * time_s + context.rng.uniform(0.0, 2.0 * np.pi))
    result: Array = force_N + amount * (force_N - 0.5 * context.full_N) * wave
    return result


def _wandering_reference(stroke: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """The reference voltage of the amplifier is a slow random walk, and scales the gain."""
    keep = float(np.exp(-context.dt_s / _number(details, "correlation_s")))
    fresh = context.rng.normal(0.0, np.sqrt(1.0 - keep * keep), stroke.size)
    return stroke * (1.0 + amount * _leaking_sum(fresh, keep))


def _one_sided_lag(voltage_V: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """The stack charges with one time constant, and discharges with a much longer one."""
    up, down = 1.0 - np.exp(-context.dt_s / amount), 1.0 - np.exp(-context.dt_s / (amount * _number(details, "ratio")))
    return _two_rate_lag(voltage_V, float(up), float(down))


def _activity_softening(stroke: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """Losses heat the stack while it moves fast; the gain falls with the heat and recovers in pauses."""
    speed = np.abs(np.gradient(stroke, context.dt_s)) / context.reach_V
    heat = respond(first_order(_number(details, "warming_s")), np.minimum(speed, 50.0) ** 1.2, context.dt_s, held=False)
    return stroke * np.maximum(1.0 - amount * heat, 0.2)


def _buffer_jitter(reading_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """The delay alternates between 0 and `amount` [s] from one transfer to the next."""
    lasts = context.rng.exponential(_number(details, "transfer_s"), int(2.0 * context.drive.time_s[-1] / 0.02) + 8)
    ends = np.cumsum(np.maximum(lasts, 0.02))
    time_s = context.drive.time_s
    late = np.searchsorted(ends, time_s) % 2 == 1
    result: Array = np.interp(time_s - amount * late, time_s, reading_N)
    return result


def _travelling_cable(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    """A cable sticks and releases after a certain travel in either direction: a saw-tooth over the path."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(force_N))))) / context.full_N
    period = _number(details, "path") * (1.0 + 0.2 * np.sin(0.37 * path))
    return force_N + amount * context.full_N * ((np.cumsum(np.diff(path, prepend=0.0) / period) % 1.0) - 0.5)


@njit(cache=True)
def _leaking_sum(values: Array, keep: float) -> Array:
    """x_k = keep x_{k-1} + value_k, shape (n,)."""
    out, x = np.empty(values.size), 0.0
    for k in range(values.size):
        x = keep * x + values[k]
        out[k] = x
    return out


@njit(cache=True)
def _widening_play(values: Array, width: Array) -> Array:
    """Play operator whose half width changes with every sample, shape (n,)."""
    out, z = np.empty(values.size), values[0]
    for k in range(values.size):
        z = max(values[k] - width[k], min(values[k] + width[k], z))
        out[k] = z
    return out


@njit(cache=True)
def _fading_peak(values: Array, keep: float) -> Array:
    """peak_k = max(value_k, keep peak_{k-1}), shape (n,)."""
    out, peak = np.empty(values.size), 0.0
    for k in range(values.size):
        peak = max(values[k], keep * peak)
        out[k] = peak
    return out


@njit(cache=True)
def _two_rate_lag(values: Array, up: float, down: float) -> Array:
    """First-order lag with one factor for rising and another for falling input, shape (n,)."""
    out, x = np.empty(values.size), values[0]
    for k in range(values.size):
        gap = values[k] - x
        x += (up if gap > 0.0 else down) * gap
        out[k] = x
    return out


def _drawn(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], dict[str, object]]:
    """Draws each detail between two values, uniformly in its logarithm."""

    def draw(rng: np.random.Generator) -> dict[str, object]:
        return {name: float(np.exp(rng.uniform(np.log(low), np.log(high)))) for name, (low, high) in ranges.items()}

    return draw


FOREIGN: dict[str, Foreign] = {
    "ratcheting_mount": Foreign(
        "force", _ratcheting_mount, 1e-4, 1.0, _drawn(yield_share=(0.55, 0.8), recovery_s=(1.0, 6.0))
    ),
    "growing_backlash": Foreign("force", _growing_backlash, 1e-4, 0.1, _drawn(path=(50.0, 200.0))),
    "emi_tare_knocks": Foreign(
        "reading", _emi_tare_knocks, 1e-5, 0.1, _drawn(per_minute=(8.0, 25.0), auto_zero_s=(2.0, 12.0))
    ),
    "thermostat_gain": Foreign("stack", _thermostat_gain, 1e-4, 0.3, _drawn(period_s=(2.5, 12.0), duty=(0.2, 0.8))),
    "softening_memory": Foreign("force", _softening_memory, 1e-4, 0.4, _drawn(memory_s=(2.0, 10.0))),
    "swapped_buffers": Foreign("reading", _swapped_buffers, 0.01, 0.8, _drawn(buffer_s=(0.02, 0.12))),
    "drive_intermodulation": Foreign("force", _drive_intermodulation, 1e-4, 0.2, _drawn(frequency_Hz=(3.0, 45.0))),
    "wandering_reference": Foreign("stack", _wandering_reference, 1e-4, 0.1, _drawn(correlation_s=(0.4, 3.0))),
    "one_sided_lag": Foreign("amplifier", _one_sided_lag, 2e-4, 0.05, _drawn(ratio=(3.0, 9.0))),
    "activity_softening": Foreign("stack", _activity_softening, 1e-4, 0.2, _drawn(warming_s=(1.5, 10.0))),
    "buffer_jitter": Foreign("reading", _buffer_jitter, 1e-3, 0.1, _drawn(transfer_s=(0.1, 0.6))),
    "travelling_cable": Foreign("force", _travelling_cable, 1e-4, 0.1, _drawn(path=(0.7, 4.0))),
}
