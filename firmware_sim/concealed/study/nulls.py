"""Benches with nothing wrong in them, as the files of an identification and of other work.

A family is the law of the hysteresis; what was recorded and how the bench writes it down vary within each family. The
plant, its noise and its force law are drawn for every bench.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import get_args

import numpy as np

from firmware_sim.concealed.plant import sampling
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive, mixed_work
from firmware_sim.concealed.plant.force_law import ForceLaw
from firmware_sim.concealed.plant.hysteresis import Kind, draw_hysteresis, draw_noncongruent
from firmware_sim.concealed.study.bench import READ_LATE
from firmware_sim.concealed.study.drawing import LEAST_NOISE, MISFIT, MOST_NOISE, superposition_misfit

FAMILIES: tuple[Kind, ...] = get_args(Kind)
RATE_HZ, DURATION_S = 500.0, 60.0
MOST_RANGES_PER_S = 20.0
VOLTAGE_NOISE = 1e-4  # of a recorded voltage [range], as a converter of 14 bit has
FINER = 4  # simulated samples per sample with an uneven clock
NEWTON_PER_POUND = 4.4482216152605


@dataclass(frozen=True)
class NullBench:
    """Files of a bench, and what a perfect model would leave of the second.

    Parameters
    ----------
    family, record, bench
        Law of the hysteresis, kind of identification record, and what is particular about the bench.
    identification, held_out
        Text with one row of names, and columns time, voltage and force.
    true
        Force of the second file without noise, in its unit, shape (n,).
    floor
        Rms of the noise in the second file, with that of a recorded voltage, in its unit.
    """

    family: Kind
    record: str
    bench: str
    identification: str
    held_out: str
    true: Array
    floor: float


@dataclass(frozen=True)
class Manner:
    """How a bench samples and writes.

    Parameters
    ----------
    rate_Hz, duration_s
        Of both files [1/s], [s].
    held
        Whether a command is held until the next, and read late.
    uneven
        Whether the time between samples varies, by up to half of its mean.
    voltage_noise
        Standard deviation on the recorded voltage [range].
    volt, newton, second
        One of each in the units of the file.
    noise
        `white` or `coloured`.
    """

    rate_Hz: float = RATE_HZ
    duration_s: float = DURATION_S
    held: bool = False
    uneven: bool = False
    voltage_noise: float = 0.0
    names: tuple[str, str, str] = ("time_s", "voltage_V", "force_N")
    volt: float = 1.0
    newton: float = 1.0
    second: float = 1.0
    noise: str = "white"


BENCHES = {
    "plain": Manner(),
    "coloured noise": Manner(noise="coloured"),
    "held, read late": Manner(held=True),
    "noisy voltage": Manner(voltage_noise=VOLTAGE_NOISE),
    "uneven clock": Manner(uneven=True),
    "50 Hz": Manner(rate_Hz=50.0, duration_s=120.0),
    "10 kHz": Manner(rate_Hz=10_000.0, duration_s=12.0),
    "millivolts": Manner(names=("Zeit [ms]", "U [mV]", "F [N]"), volt=1e3, second=1e3),
    "pounds": Manner(names=("Time [s]", "Voltage [V]", "Force [lbf]"), newton=1.0 / NEWTON_PER_POUND),
    "negative gain": Manner(newton=-1.0),
}


def draw_null(family: Kind, number: int, seed: np.random.SeedSequence) -> NullBench:
    """Draw a bench of a family.

    Parameters
    ----------
    family
        Law of the hysteresis.
    number
        Its place in the family: neighbours differ in record and manner.
    seed
        Seed of everything drawn.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    record = tuple(RECORDS)[number % len(RECORDS)]
    bench = tuple(BENCHES)[(number + number // len(BENCHES)) % len(BENCHES)]
    manner = BENCHES[bench]
    before, slow = RECORDS[record](rng, manner.rate_Hz, manner.duration_s)
    while True:
        reach_V = round(rng.uniform(60.0, 200.0), 1)
        full_N = float(np.exp(rng.uniform(np.log(50.0), np.log(2000.0))))
        law = ForceLaw(full_N, rng.uniform(-0.2, 0.25), rng.uniform(-0.06, 0.12))
        plant = Plant(draw_hysteresis(rng, family, reach_V), draw_noncongruent(rng, reach_V), law)
        work = mixed_work(rng, reach_V, manner.rate_Hz, manner.duration_s, MOST_RANGES_PER_S * reach_V)
        least = superposition_misfit(plant.hysteresis, work, manner.rate_Hz) / MISFIT
        if least <= MOST_NOISE:  # else no sum of plays follows it, which counts as an effect
            break
    noise_N = full_N * float(np.exp(rng.uniform(np.log(max(LEAST_NOISE, least)), np.log(MOST_NOISE))))
    late = rng.uniform(*READ_LATE) if manner.held else 0.0
    write = partial(_written, rng, plant, manner, late, noise_N)
    identification, _ = write(before, reach_V * slow)
    held_out, true = write(np.zeros(0), work)
    floor = abs(manner.newton) * float(np.hypot(noise_N, full_N * manner.voltage_noise))
    return NullBench(family, record, bench, identification, held_out, true, floor)


def _written(
    rng: np.random.Generator, plant: Plant, manner: Manner, late: float, noise_N: float, before: Array, voltage: Array
) -> tuple[str, Array]:
    """Text of a record and its force without noise; `before` (relative) is driven, and not written."""
    reach_V = plant.hysteresis.reach_V
    commands = reach_V * before, np.asarray(np.round(voltage, 4), dtype=np.float64)
    driven_V, at, rate_Hz = np.concatenate(commands), np.arange(voltage.size), manner.rate_Hz
    if manner.uneven:  # straight from one sample to the next, whenever they are
        rate_Hz, finer = FINER * rate_Hz, np.arange(FINER * driven_V.size)
        at = FINER * np.arange(driven_V.size) + rng.integers(0, FINER, driven_V.size)
        driven_V, at = np.interp(finer, at, driven_V), at[before.size :]
    drive = Drive(driven_V, rate_Hz, manner.held, late, np.zeros(driven_V.size))
    true_N = plant.reading_N(drive, {}, 0)
    true_N = true_N[at] if manner.uneven else true_N[before.size :]
    corner_Hz = float(np.exp(rng.uniform(np.log(0.5), np.log(20.0))))
    force_N = true_N + sampling.noise(rng, at.size, noise_N, manner.noise, manner.rate_Hz, corner_Hz)
    voltage_V = commands[1] + manner.voltage_noise * reach_V * rng.normal(0.0, 1.0, at.size)
    columns = (manner.second * at / rate_Hz, manner.volt * voltage_V, manner.newton * force_N)
    rows = ["{:.6f},{:.5f},{:.6g}".format(*row) for row in zip(*columns, strict=True)]
    return "\n".join((",".join(manner.names), *rows, "")), manner.newton * true_N


def _through(rate_Hz: float, duration_s: float, corners: Array, lasts: Array) -> Array:
    """Straight lines through corners, which last relative times, shape (duration rate,)."""
    times = np.concatenate(([0.0], np.cumsum(lasts)))
    points = np.arange(round(duration_s * rate_Hz)) / rate_Hz
    result: Array = np.interp(points, duration_s * times / times[-1], corners)
    return result


def _triangles(peaks: Array, rate_Hz: float, duration_s: float) -> tuple[Array, Array]:
    corners = np.concatenate(([0.0], np.column_stack((peaks, np.zeros(peaks.size))).ravel()))
    return np.zeros(0), _through(rate_Hz, duration_s, corners, np.abs(np.diff(corners)))


def _growing(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> tuple[Array, Array]:
    count = int(rng.integers(6, 16))
    return _triangles(np.arange(1, count + 1) / count, rate_Hz, duration_s)


def _constant(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> tuple[Array, Array]:
    return _triangles(np.ones(int(rng.integers(4, 13))), rate_Hz, duration_s)


def _sine_amid(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> tuple[Array, Array]:
    """The file begins in the middle of the range, after a rise that is not in it."""
    phase = 2.0 * np.pi * rng.integers(5, 21) * np.arange(round(duration_s * rate_Hz)) / (duration_s * rate_Hz)
    return np.linspace(0.0, 0.5, round(rate_Hz)), 0.5 + 0.5 * np.sin(phase)


def _staircase(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> tuple[Array, Array]:
    """Two flights up and down; every second tread goes back by a part of its height."""
    steps = int(rng.integers(8, 16))
    up = np.arange(steps + 1) / steps
    flight = np.concatenate((up, up[-2::-1]))
    flight = np.concatenate((flight, flight[1:]))
    levels = [level for a, b in pairwise(flight) for level in (b, b - rng.uniform(0.0, 1.0) * (b - a), b)]
    corners = np.repeat(np.concatenate(([0.0], levels)), 2)  # a rise, then a rest
    return np.zeros(0), _through(rate_Hz, duration_s, corners, np.resize((2.0, 1.0), corners.size - 1)[::-1])


RECORDS: dict[str, Callable[[np.random.Generator, float, float], tuple[Array, Array]]] = {
    "growing triangles": _growing,
    "constant triangles": _constant,
    "sine from the middle": _sine_amid,
    "staircase": _staircase,
}
