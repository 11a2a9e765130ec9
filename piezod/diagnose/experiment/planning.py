"""Next experiment: a drive that separates effects, within the range of the recordings and a slew limit.

Each segment of a few seconds is simulated with the model. Its information about a pair of effects is the inverse square
of their separable size, and adds up over segments. Segments with the most information per duration are joined. One
sweep over the range precedes them and erases the memory of earlier drives. A simulation of the joined drive with the
recordings gives the promised sizes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.experiment.isolability import Isolability, Pair, Settings, isolability, separated_by
from piezod.diagnose.hypothesis.parallel import each
from piezod.effects import EFFECTS
from piezod.estimation.recordings.sources import Source
from piezod.excitation import multisine, staircase, steps, triangle
from piezod.model import Model, run_chain
from piezod.recording import Recording

INNER = 0.98  # share of the range of the recordings that is driven
NOT_SEPARATED = 1e6  # separable size of a pair with an invisible effect [noise rms]
LOOP_BIASES = (0.2, 0.5, 0.8)  # centres of the minor loops, relative to the range


@dataclass(frozen=True)
class Experiment:
    """Drive and the separable sizes that it promises."""

    voltage_V: Array  # drive, shape (N,) [input unit]
    dt_s: float  # sampling period of the first recording [s]
    segments: tuple[str, ...]
    pairs: tuple[Pair, ...]  # pairs of effects with their separable sizes before
    sizes: tuple[float, ...]  # separable sizes of these pairs with the drive added [noise rms]

    def recording(self, channel: str) -> Recording:
        """Drive as a recording of the model input `channel`, for `piezod record --excitation`."""
        time_s = np.arange(self.voltage_V.size, dtype=np.float64) * self.dt_s
        return Recording(time_s, {channel: self.voltage_V}, {}, "experiment")


def next_experiment(
    model: Model,
    recordings: Sequence[Source],
    past: Sequence[Source],
    before: Isolability,
    longest_s: float,
    wanted: Sequence[tuple[str, str]] | None = None,
    fitted: Settings | None = None,
    slew: float | None = None,
) -> Experiment | None:
    """Plan the drive; None if no pair of effects is open or no segment fits.

    Parameters
    ----------
    recordings, past
        Recordings, as for `isolability`.
    longest_s
        Longest duration of the drive [s].
    wanted
        Pairs of effects to separate; None: all open pairs.
    fitted
        Fitted effects, as for `before`.
    slew
        Largest rate of the drive [input unit/s]; None: the largest of the first recording.
    """
    pairs = tuple(before.pairs() if wanted is None else _pairs(before, wanted))
    if not pairs:
        return None
    only = {name for pair in pairs for name in (pair.first, pair.second)}
    first = recordings[0].recording
    command_V = first.channel(model.input.channel)
    known = command_V[np.isfinite(command_V)]
    low_V, high_V = float(known.min()), float(known.max())
    most_V = float(np.max(np.abs(np.diff(known)), initial=0.0)) if slew is None else slew * first.dt_s  # per sample
    segments = _segments(low_V, high_V, first.dt_s, most_V)

    def information_of(segment: tuple[str, Array]) -> Array:
        answer = _simulated(model, segment[1], first.dt_s, before.noise)
        result = isolability(model, [answer], past, fitted, only)
        return np.array([separation(result, pair.first, pair.second) ** -2.0 for pair in pairs])

    information = each(information_of, segments)
    sweep = np.full(int(np.ceil((high_V - low_V) / most_V)), low_V + INNER * (high_V - low_V))
    sweep_V = _slewed(sweep, low_V, most_V)
    sizes = [drive.size for _, drive in segments]
    known_information = np.array([pair.size**-2.0 for pair in pairs])
    available_s = longest_s - sweep_V.size * first.dt_s
    chosen = _chosen(known_information, information, sizes, first.dt_s, available_s)
    if not chosen:
        return None
    voltage_V = np.concatenate([sweep_V, *(segments[k][1] for k in chosen)])  # every segment returns to the lowest one
    new = _simulated(model, voltage_V, first.dt_s, before.noise)
    after = isolability(model, [*recordings, new], past, fitted, only)
    promised = tuple(separation(after, pair.first, pair.second) for pair in pairs)
    return Experiment(voltage_V, first.dt_s, tuple(segments[k][0] for k in chosen), pairs, promised)


def _chosen(
    known: Array, information: Sequence[Array], sizes: Sequence[int], dt_s: float, available_s: float
) -> list[int]:
    """Numbers of the segments with the largest gain per sample, rising, as long as time is available."""
    chosen: list[int] = []
    total = known
    while True:
        fitting = [k for k, size in enumerate(sizes) if size * dt_s <= available_s]
        if not fitting:
            return sorted(chosen)
        best = max(fitting, key=lambda k: _information_gain(total, information[k]) / sizes[k])
        chosen.append(best)
        total = total + information[best]
        available_s -= sizes[best] * dt_s


def _pairs(before: Isolability, wanted: Sequence[tuple[str, str]]) -> list[Pair]:
    """Wanted pairs of effects that the recordings show, with their separable sizes."""
    return [
        Pair(first, second, separation(before, first, second), separated_by(EFFECTS[first], EFFECTS[second]))
        for first, second in wanted
        if {first, second} <= set(before.effects)
    ]


def _information_gain(total: Array, more: Array) -> float:
    """Sum of the logarithmic gains over all pairs; a pair with little information counts most."""
    return float(np.sum(np.log1p(more / total)))


def separation(result: Isolability, first: str, second: str) -> float:
    """Smallest separable size of two effects [noise rms]; `NOT_SEPARATED` if the recordings do not show both."""
    places = [result.effects.index(name) for name in (first, second) if name in result.effects]
    if len(places) < 2:
        return NOT_SEPARATED
    return float(max(result.separated_from[places[0], places[1]], result.separated_from[places[1], places[0]]))


def _simulated(model: Model, voltage_V: Array, dt_s: float, noise: float) -> Source:
    """Simulated recording of a drive, with the noise of the recordings."""
    time_s = np.arange(voltage_V.size, dtype=np.float64) * dt_s
    expected = run_chain(model, model.operator(), time_s, voltage_V, temperature_C=np.zeros(voltage_V.size))
    answer = expected + np.random.default_rng(0).normal(0.0, noise, voltage_V.size)
    channels = {model.input.channel: voltage_V, model.output.channel: answer}
    return Source(Recording(time_s, channels, {}, "experiment"), "experiment", "recording")


def _segments(low_V: float, high_V: float, dt_s: float, most_V: float) -> list[tuple[str, Array]]:
    """Names and drives of the segments, from the lowest voltage back to it, with at most `most_V` per sample."""
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
    """Drive that follows another one with a slew limit, from `start_V` and back to it."""
    farthest_V = float(np.abs(drive - start_V).max())
    wanted = np.concatenate((drive, np.full(int(np.ceil(farthest_V / most_V)), start_V)))
    out = np.empty(wanted.size)
    now = start_V
    for k, value in enumerate(wanted):
        now += min(max(value - now, -most_V), most_V)
        out[k] = now
    return out
