"""Effects that are in no catalogue: what a diagnosis must flag and must not give a name.

Each acts at one stage of the chain, on the fine grid or (at `reading`) on the samples, and grows with one `amount`.
None of them can be written as one entry of the catalogue with any parameters: they depend on a product of drive and
time, on the path travelled, on the history of the load, or on a clock of their own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.linear import first_order, respond


@dataclass(frozen=True)
class Surroundings:
    """What an effect may look at besides the signal.

    Parameters
    ----------
    drive
        The record's commands.
    dt_s
        Step of the signal's grid [s].
    reach_V, full_N
        Ranges [V], [N].
    rng
        What is random in this record.
    """

    drive: Drive
    dt_s: float
    reach_V: float
    full_N: float
    rng: np.random.Generator


Details = Mapping[str, object]
Apply = Callable[[Array, float, Details, Surroundings], Array]


@dataclass(frozen=True)
class Foreign:
    """One foreign effect.

    Parameters
    ----------
    stage
        `amplifier`, `stack`, `force` or `reading`.
    apply
        The signal with the effect of an amount.
    least, most
        Range of the amount (1; s for times).
    details
        Draws what else there is.
    """

    stage: str
    apply: Apply
    least: float
    most: float
    details: Callable[[np.random.Generator], dict[str, object]]


def _number(details: Details, name: str) -> float:
    value = details[name]
    assert isinstance(value, (int, float))
    return float(value)


def _ratcheting_mount(force_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """The mount gives a little for good whenever the force is high, and settles back when it is gone."""
    load = np.maximum(force_N / at.full_N - _number(details, "yield_share"), 0.0) ** 1.5
    slip = _leaking_sum(load * at.dt_s, np.exp(-at.dt_s / _number(details, "recovery_s")))
    return force_N - amount * at.full_N * slip


def _growing_backlash(force_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """A worn joint whose play widens with the path travelled."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(force_N))))) / at.full_N
    width_N = amount * at.full_N * (path / _number(details, "path")) ** 0.7
    return _widening_play(force_N, width_N)


def _emi_tare_knocks(reading_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """Bursts knock the tare about; an auto-zero brings it back slowly."""
    knocks = np.zeros(reading_N.size)
    count = max(6, int(_number(details, "per_minute") * at.drive.time_s[-1] / 60.0))
    where = at.rng.integers(0, reading_N.size, count)
    np.add.at(knocks, where, at.rng.normal(0.0, 1.0, count))
    return reading_N + amount * at.full_N * _leaking_sum(knocks, np.exp(-at.dt_s / _number(details, "auto_zero_s")))


def _thermostat_gain(stroke: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """A heater switches on and off at its own period and the gain follows its saw-tooth."""
    phase = np.arange(stroke.size) * at.dt_s / _number(details, "period_s") + at.rng.uniform()
    duty = _number(details, "duty")
    part = phase % 1.0
    tooth = np.where(part < duty, part / duty, (1.0 - part) / (1.0 - duty))
    return stroke * (1.0 + amount * (tooth - 0.5))


def _softening_memory(force_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """Softer below the highest force of late (Mullins), a memory that fades."""
    highest_N = _fading_peak(force_N, float(np.exp(-at.dt_s / _number(details, "memory_s"))))
    below = np.clip(1.0 - force_N / np.maximum(highest_N, 1e-6 * at.full_N), 0.0, 1.0)
    return force_N * (1.0 - amount * below)


def _swapped_buffers(reading_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """Neighbouring buffers arrive in the wrong order; `amount` is the share of pairs."""
    size = max(4, round(_number(details, "buffer_s") / at.dt_s))
    result = reading_N.copy()
    chance = at.rng.uniform(size=reading_N.size // (2 * size))
    for pair in np.flatnonzero(chance < amount):
        start, middle, end = 2 * pair * size, (2 * pair + 1) * size, (2 * pair + 2) * size
        result[start:end] = np.concatenate((reading_N[middle:end], reading_N[start:middle]))
    return result


def _drive_intermodulation(force_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """A tone that is as loud as the drive's distance from half range: side-bands, no steady line."""
    time_s = np.arange(force_N.size) * at.dt_s
    wave = np.sin(2.0 * np.pi * _number(details, "frequency_Hz") * time_s + at.rng.uniform(0.0, 2.0 * np.pi))
    result: Array = force_N + amount * (force_N - 0.5 * at.full_N) * wave
    return result


def _wandering_reference(stroke: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """The amplifier's reference voltage wanders, and the gain with it."""
    keep = float(np.exp(-at.dt_s / _number(details, "correlation_s")))
    fresh = at.rng.normal(0.0, np.sqrt(1.0 - keep * keep), stroke.size)
    return stroke * (1.0 + amount * _leaking_sum(fresh, keep))


def _one_sided_lag(voltage_V: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """Charges through one path, discharges through another that is much slower."""
    up, down = 1.0 - np.exp(-at.dt_s / amount), 1.0 - np.exp(-at.dt_s / (amount * _number(details, "ratio")))
    return _two_pace_follow(voltage_V, float(up), float(down))


def _activity_softening(stroke: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """Losses warm the stack while it works hard, the gain falls, and recovers in pauses."""
    speed = np.abs(np.gradient(stroke, at.dt_s)) / at.reach_V
    heat = respond(first_order(_number(details, "warming_s")), np.minimum(speed, 50.0) ** 1.2, at.dt_s, stairs=False)
    return stroke * np.maximum(1.0 - amount * heat, 0.2)


def _buffer_jitter(reading_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """The delay jumps between nothing and `amount` [s] from one transfer to the next."""
    lasts = at.rng.exponential(_number(details, "transfer_s"), int(2.0 * at.drive.time_s[-1] / 0.02) + 8)
    ends = np.cumsum(np.maximum(lasts, 0.02))
    time_s = at.drive.time_s
    late = np.searchsorted(ends, time_s) % 2 == 1
    result: Array = np.interp(time_s - amount * late, time_s, reading_N)
    return result


def _travelling_cable(force_N: Array, amount: float, details: Details, at: Surroundings) -> Array:
    """A cable drags along and lets go after so much travel, whichever way: a saw-tooth over the path."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(force_N))))) / at.full_N
    period = _number(details, "path") * (1.0 + 0.2 * np.sin(0.37 * path))
    return force_N + amount * at.full_N * ((np.cumsum(np.diff(path, prepend=0.0) / period) % 1.0) - 0.5)


@njit(cache=True)
def _leaking_sum(values: Array, keep: float) -> Array:
    out, x = np.empty(values.size), 0.0
    for k in range(values.size):
        x = keep * x + values[k]
        out[k] = x
    return out


@njit(cache=True)
def _widening_play(values: Array, width: Array) -> Array:
    out, z = np.empty(values.size), values[0]
    for k in range(values.size):
        z = max(values[k] - width[k], min(values[k] + width[k], z))
        out[k] = z
    return out


@njit(cache=True)
def _fading_peak(values: Array, keep: float) -> Array:
    out, peak = np.empty(values.size), 0.0
    for k in range(values.size):
        peak = max(values[k], keep * peak)
        out[k] = peak
    return out


@njit(cache=True)
def _two_pace_follow(values: Array, up: float, down: float) -> Array:
    out, x = np.empty(values.size), values[0]
    for k in range(values.size):
        gap = values[k] - x
        x += (up if gap > 0.0 else down) * gap
        out[k] = x
    return out


def _drawn(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], dict[str, object]]:
    """Draws each detail between two values, evenly on a logarithm."""

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
