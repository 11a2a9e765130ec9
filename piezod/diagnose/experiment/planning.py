"""The next experiment: a drive that separates what recordings leave open, within the range that they had and a slew.

Segments of a few seconds are simulated with the model, each alone. What they tell of a pair of effects adds up like the
inverse square of the size from which on the pair is separated. The segments that raise the least of these sums most are
joined, behind one rise over the range and back, which erases the memory of earlier drives. The whole drive is then
simulated once more, beside the recordings, for the sizes that are promised.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.experiment.isolability import Found, Isolability, Pair, isolability, separated_by
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.prepare import Source
from piezod.effects import EFFECTS
from piezod.excitation import multisine, staircase, steps, triangle
from piezod.model import Model, run_chain
from piezod.recording import Recording

Array = NDArray[np.float64]

INNER = 0.98
"""Part of the range of the recordings that is driven."""

NOT_SEPARATED = 1e6
"""Size in noises of a pair of which one effect does not show at all."""

LOOP_BIASES = (0.2, 0.5, 0.8)
"""Centres of minor loops, as parts of the range."""


@dataclass(frozen=True)
class Experiment:
    """A drive and what it promises.

    Parameters
    ----------
    voltage_V
        One a sample of the first recording's period, shape (N,) [input unit].
    dt_s
        That period [s].
    segments
        What it is made of.
    pairs
        Pairs of effects that were open, with their sizes before.
    sizes
        The same sizes with the drive added, in noises.
    """

    voltage_V: Array
    dt_s: float
    segments: tuple[str, ...]
    pairs: tuple[Pair, ...]
    sizes: tuple[float, ...]

    def recording(self, channel: str) -> Recording:
        """The drive as a recording of its voltage, which `piezod record --excitation` drives.

        Parameters
        ----------
        channel
            Name of the model's input.
        """
        time_s = np.arange(self.voltage_V.size, dtype=np.float64) * self.dt_s
        return Recording(time_s, {channel: self.voltage_V}, {}, "experiment")


def next_experiment(
    model: Model,
    asked: Sequence[Source],
    past: Sequence[Source],
    before: Isolability,
    longest_s: float,
    wanted: Sequence[tuple[str, str]] | None = None,
    fitted: Found | None = None,
    slew: float | None = None,
) -> Experiment | None:
    """Find the drive; None where no pair of effects is open.

    Parameters
    ----------
    model
        Identified model.
    asked, past
        Recordings so far, as for `isolability`.
    before
        What they can tell.
    longest_s
        Longest duration of the drive [s].
    wanted
        Pairs of effects to separate; None: all that are open.
    fitted
        Effects as they were found, as for `before`.
    slew
        Largest rate of the drive [input unit/s]; None: that of the first recording.
    """
    pairs = tuple(before.pairs() if wanted is None else _pairs(before, wanted))
    if not pairs:
        return None
    only = {name for pair in pairs for name in (pair.first, pair.second)}
    first = asked[0].recording
    command_V = first.channel(model.input.channel)
    known = command_V[np.isfinite(command_V)]
    low_V, high_V = float(known.min()), float(known.max())
    most_V = float(np.max(np.abs(np.diff(known)), initial=0.0)) if slew is None else slew * first.dt_s  # a sample
    drives = _segments(low_V, high_V, first.dt_s, most_V)

    def alone(one: tuple[str, Array]) -> Array:
        found = isolability(model, [_simulated(model, one[1], first.dt_s, before.noise)], past, fitted, only)
        return np.array([separation(found, pair.first, pair.second) ** -2.0 for pair in pairs])

    told = each(alone, drives)
    chosen: list[int] = []
    rise = np.full(int(np.ceil((high_V - low_V) / most_V)), low_V + INNER * (high_V - low_V))
    first_V = _slewed(rise, low_V, most_V)
    total, left_s = np.array([pair.size**-2.0 for pair in pairs]), longest_s - first_V.size * first.dt_s
    while True:
        fitting = [k for k, (_, drive) in enumerate(drives) if drive.size * first.dt_s <= left_s]
        if not fitting:
            break
        best = max(fitting, key=lambda k: _worth(total, told[k]) / drives[k][1].size)
        chosen.append(best)
        total = total + told[best]
        left_s -= drives[best][1].size * first.dt_s
    if not chosen:
        return None
    parts = [drives[k][1] for k in sorted(chosen)]  # each comes back to where the next one begins
    voltage_V = np.concatenate([first_V, *parts])
    new = _simulated(model, voltage_V, first.dt_s, before.noise)
    after = isolability(model, [*asked, new], past, fitted, only)
    names = tuple(drives[k][0] for k in sorted(chosen))
    return Experiment(
        voltage_V, first.dt_s, names, pairs, tuple(separation(after, pair.first, pair.second) for pair in pairs)
    )


def _pairs(before: Isolability, wanted: Sequence[tuple[str, str]]) -> list[Pair]:
    """Pairs that the recordings show, with their sizes."""
    shown = [(one, other) for one, other in wanted if {one, other} <= set(before.effects)]
    return [
        Pair(one, other, separation(before, one, other), separated_by(EFFECTS[one], EFFECTS[other]))
        for one, other in shown
    ]


def _worth(total: Array, more: Array) -> float:
    """How much further all pairs come, in the mean of the logarithms: what is least known counts most."""
    return float(np.sum(np.log1p(more / total)))


def separation(found: Isolability, first: str, second: str) -> float:
    """Size from which on two effects are separated, in noises; a large one where a recording does not show both.

    Parameters
    ----------
    found
        What recordings can tell.
    first, second
        Names of the effects.
    """
    places = [found.effects.index(name) for name in (first, second) if name in found.effects]
    if len(places) < 2:
        return NOT_SEPARATED
    return float(max(found.separated_from[places[0], places[1]], found.separated_from[places[1], places[0]]))


def _simulated(model: Model, voltage_V: Array, dt_s: float, noise: float) -> Source:
    """What the model answers to a drive, with the noise of the recordings."""
    time_s = np.arange(voltage_V.size, dtype=np.float64) * dt_s
    expected = run_chain(model, model.operator(), time_s, voltage_V, temperature_C=np.zeros(voltage_V.size))
    answer = expected + np.random.default_rng(0).normal(0.0, noise, voltage_V.size)
    channels = {model.input.channel: voltage_V, model.output.channel: answer}
    return Source(Recording(time_s, channels, {}, "experiment"), "experiment", "recording")


def _segments(low_V: float, high_V: float, dt_s: float, most_V: float) -> list[tuple[str, Array]]:
    """Names and drives; each begins and ends at the lowest voltage and is no faster than `most_V` a sample."""
    middle_V, reach_V = 0.5 * (low_V + high_V), 0.5 * INNER * (high_V - low_V)
    fastest_Hz = most_V / (4.0 * reach_V * dt_s)  # of a triangle over the range

    def over(duration_s: float, form: Callable[[Array], Array], at_V: float = middle_V, by_V: float = reach_V) -> Array:
        phase = np.arange(int(duration_s / dt_s)) / max(int(duration_s / dt_s), 1)
        return at_V + by_V * form(phase)

    def loops(duration_s: float) -> Array:
        parts = [low_V + bias * (high_V - low_V) for bias in LOOP_BIASES]
        each_s = duration_s / len(parts)
        return np.concatenate([over(each_s, lambda p: triangle(3.0 * p), at, 0.3 * reach_V) for at in parts])

    fast = max(1.0, min(round(0.8 * fastest_Hz * 6.0), 60.0))
    drives = [
        ("slow triangles", over(12.0, lambda p: triangle(2.0 * p))),
        ("fast triangles", over(6.0, lambda p: triangle(fast * p))),
        ("steps", over(12.0, lambda p: steps(p, 12, 1))),
        ("steps in quick order", over(6.0, lambda p: steps(3.0 * p, 10, 2))),
        ("staircase with holds", over(24.0, lambda p: staircase(p, 5))),
        ("minor loops at three biases", loops(12.0)),
        ("multisine", over(10.0, lambda p: multisine(max(1.0, round(0.1 * fast)) * p, 1))),
    ]
    return [(name, _slewed(drive, low_V, most_V)) for name, drive in drives]


def _slewed(drive: Array, start_V: float, most_V: float) -> Array:
    """A drive that follows another one at a limited slew, from a voltage and back to it."""
    farthest_V = float(np.abs(drive - start_V).max())
    wanted = np.concatenate((drive, np.full(int(np.ceil(farthest_V / most_V)), start_V)))
    out = np.empty(wanted.size)
    now = start_V
    for k, value in enumerate(wanted):
        now += min(max(value - now, -most_V), most_V)
        out[k] = now
    return out
