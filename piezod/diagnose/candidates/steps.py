"""Steps of the load: the span of time that, shifted, explains most of what is left, and whether its edges are sharp."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NEVER_S = 1e7  # where a step that stays ends
CELLS = 400  # of a recording, at whose edges a step may come or go at first
APART = 4  # cells between one proposal's edges and the next one's
SHORTEST = 2  # cells
WINDOWS_S = (0.1, 0.3, 1.0, 3.0)  # before and after an edge
JUMP_S = 0.3  # before and after, where the clearest jump is looked for
LEAPS_PASSED = 20  # of the command
EDGE_WITHIN_S, EDGE_LOOKED_AT_S = 0.25, 0.5  # of where it was fitted on few samples; around it
CLEAR = 5.0  # jump of the means on both sides of an edge, in the standard deviations that such jumps have elsewhere
LIKE_THE_STEP = 0.4  # by how much of the height a jump may differ from it,
OF_LATTICE = 0.5  # of a coarse converter's step: a lower one is the lattice's own beat
LEAPS_WITHIN_S, LEAP = 0.05, 0.5  # of an edge; of the command's largest move
RARE, BEYOND_IT = 90.0, 1.5  # percentile of the command's moves; how far beyond it a leap goes: no sine is that uneven
STEPS_BY, APART_S, FEWEST_ALIKE = 0.1, 0.5, 5  # of the command's range from a sample to the next; others like it
CHANCE = 2.0  # and by how many such standard deviations besides


@dataclass(frozen=True)
class Step:
    """A shift of the reading for a while.

    Parameters
    ----------
    height_N
        By how much [N].
    first, end
        Samples; `end` is the number of samples where it stays.
    """

    height_N: float
    first: int
    end: int


def likely_steps(normal: Normal, number: int, most: int = 2) -> list[Step]:
    """Spans whose shift would lower the squared residual most, everything else refitted to first order.

    Parameters
    ----------
    normal
        At the hypothesis so far.
    number
        Of the recording.
    most
        Spans that share no edge.
    """
    series, rows = normal.chain.series[number], normal.chain.rows[number]
    size, step = normal.weights[number].size, rows.step or 1
    sums = _Sums.of(normal, number)
    edges = np.unique(np.linspace(0, size, CELLS + 1).astype(int))
    gains = sums.gains(edges[:, None], edges[None, :])
    index = np.arange(edges.size)
    gains[index[None, :] - index[:, None] < SHORTEST] = 0.0
    found: list[Step] = []
    while len(found) < most:
        a, b = (int(x) for x in np.unravel_index(int(np.argmax(gains)), gains.shape))
        if gains[a, b] <= 0.0:
            break
        first, end = _sharpest(sums, edges, a, b)
        height_N = sums.height_N(first, end)
        whole = series.time_s.size
        found.append(Step(height_N, first * step, whole if end == size else min(end * step, whole)))
        gains[max(a - APART, 0) : a + APART + 1, :] = 0.0
        gains[:, max(b - APART, 0) : b + APART + 1] = 0.0
    return found


def sharpest_steps(series: Series, residual_N: Array) -> list[Step]:
    """The clearest jump of a residual at an instant of which the command knows nothing: for good, and until one back.

    What explains most may have one of its edges elsewhere, where something else is still missing.
    """
    near, size = round(JUMP_S / series.dt_s), series.time_s.size
    if near < 5 or size < 4 * near:
        return []
    jumps = _jumps(np.where(series.counts, residual_N, 0.0), near)
    clear = CLEAR * _usual(jumps)
    place, height_N = _largest(series, jumps, near)
    if abs(height_N) < clear:
        return []
    steps = [Step(height_N, place, size)]
    back, back_N = _largest(series, -np.sign(height_N) * jumps, near, signed=True)
    if back > place and back_N > max(clear, (1.0 - LIKE_THE_STEP) * abs(height_N)):
        steps.append(Step(height_N, place, back))
    return steps


def _jumps(values: Array, near: int) -> Array:
    """Mean of the `near` values from a sample on less that of those before it, for every sample but the outermost."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    middles = np.arange(near, values.size - near)
    jumps: Array = (total[middles + near] - 2.0 * total[middles] + total[middles - near]) / near
    return jumps


def _largest(series: Series, jumps: Array, near: int, *, signed: bool = False) -> tuple[int, float]:
    """Sample and height of the largest jump that the command has not made."""
    sizes = jumps.copy() if signed else np.abs(jumps)
    for _ in range(LEAPS_PASSED):
        k = int(np.argmax(sizes))
        if not _command_leaps(series, k + near):
            break
        sizes[max(k - near, 0) : k + near] = -np.inf
    return k + near, float(jumps[k])


def _sharpest(sums: "_Sums", edges: Array, a: int, b: int) -> tuple[int, int]:
    """Sample by sample near both edges, the one after the other, twice."""
    first, end = int(edges[a]), int(edges[b])
    starts = np.arange(edges[max(a - 1, 0)], edges[min(a + 1, edges.size - 1)] + 1)
    ends = np.arange(edges[max(b - 1, 0)], edges[min(b + 1, edges.size - 1)] + 1)
    for _ in range(2):
        if a > 0:
            first = int(starts[np.argmax(np.where(starts < end, sums.gains(starts, np.array(end)), 0.0))])
        if b < edges.size - 1:
            end = int(ends[np.argmax(np.where(ends > first, sums.gains(np.array(first), ends), 0.0))])
    return first, end


@dataclass(frozen=True)
class _Sums:
    """Running sums, so that a span's are differences."""

    along: Array  # (N + 1,)
    length: Array  # (N + 1,)
    across: Array  # (N + 1, P), whitened by the normal equations
    gradient: Array  # (P,), whitened

    @classmethod
    def of(cls, normal: Normal, number: int) -> "_Sums":
        hessian = normal.hessian.sum(axis=0) + normal.ridge
        scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        values, vectors = np.linalg.eigh(hessian * np.outer(scale, scale))
        whiten = (scale[:, None] * vectors) / np.sqrt(np.maximum(values, 1e-12))
        change = normal.told[number] / normal.chain.series[number].noise_N  # of the residuals with a step's height
        columns = (normal.weights[number] * change)[:, None] * normal.jacobians[number]
        return cls(
            np.concatenate(([0.0], np.cumsum(normal.weighted[number] * change))),
            np.concatenate(([0.0], np.cumsum(normal.weights[number] * change**2))),
            np.vstack((np.zeros(whiten.shape[1]), np.cumsum(columns, axis=0))) @ whiten,
            (normal.gradient.sum(axis=0) + normal.pull) @ whiten,
        )

    def _parts(self, first: NDArray[np.int64], end: NDArray[np.int64]) -> tuple[Array, Array]:
        across = self.across[end] - self.across[first]
        along = self.along[end] - self.along[first] - across @ self.gradient
        length = self.length[end] - self.length[first]
        return along, np.maximum(length - np.sum(across * across, axis=-1), 1e-6 * length + 1e-300)

    def gains(self, first: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
        along, free = self._parts(first, end)
        gains: Array = along * along / free
        return gains

    def height_N(self, first: int, end: int) -> float:
        along, free = self._parts(np.array(first), np.array(end))
        return float(along / free)


def edge_near(series: Series, without_N: Array, at_s: float) -> float:
    """Where near an instant two levels, before it and after it, fit a residual best [s].

    Parameters
    ----------
    series
        The recording.
    without_N
        Reading less simulation without the step, shape (N,) [N].
    at_s
        Near which it is looked for.
    """
    dt_s, size = series.dt_s, series.time_s.size
    middle, reach, near = round(at_s / dt_s), round(EDGE_WITHIN_S / dt_s), round(EDGE_LOOKED_AT_S / dt_s)
    first, end = max(middle - reach - near, 0), min(middle + reach + near, size)
    values, counts = without_N[first:end], series.counts[first:end].astype(np.float64)
    places = np.arange(max(middle - reach, first + 2), min(middle + reach, end - 2))
    if places.size == 0 or not counts.any():
        return at_s
    sums, told = np.cumsum(np.where(counts > 0.0, values, 0.0)), np.cumsum(counts)
    before, known = sums[places - first - 1], told[places - first - 1]
    level = before**2 / np.maximum(known, 1.0) + (sums[-1] - before) ** 2 / np.maximum(told[-1] - known, 1.0)
    return float(places[int(np.argmax(level))]) * dt_s


def shown_late_s(chain: Chain, terms: Sequence[Term], point: Point) -> float:
    """How much later than the load an edge of it shows in the reading, by what stands behind the mechanics [s].

    Parameters
    ----------
    chain
        Of the recordings.
    terms
        Of the hypothesis; the last is the step.
    point
        Its values.
    """
    number, values = terms[-1].series, point.values[-1]
    time_s = chain.series[number].time_s
    still = replace(point, values=(*point.values[:-1], {**values, "step_N": 0.0}))
    change_N = chain.run(number, terms, point).reading_N - chain.run(number, terms, still).reading_N
    part = change_N / values["step_N"] if values["step_N"] else np.zeros(time_s.size)
    edge_s = values["on_s"]
    if not 0.0 < edge_s < time_s[-1]:
        part, edge_s = 1.0 - part, values["off_s"]
    after = int(np.searchsorted(time_s, edge_s))
    there = np.flatnonzero(part[after:] >= 0.5)
    if after == 0 or there.size == 0:
        return 0.0
    k = after + int(there[0])
    half_s = float(np.interp(0.5, part[k - 1 : k + 1], time_s[k - 1 : k + 1]))
    return max(half_s - edge_s - 0.5 * values["rise_s"], 0.0)


def sharp(series: Series, residual_N: Array, step: Step) -> bool:
    """Whether the reading jumps by the step's height at each of its edges, clearly beyond what it does elsewhere.

    And at instants of which the command knows nothing.

    Parameters
    ----------
    series
        The recording.
    residual_N
        Reading less simulation with the step, shape (N,) [N].
    step
        As it was fitted.
    """
    values = np.where(series.counts, residual_N, 0.0)
    size = values.size
    if abs(step.height_N) < OF_LATTICE * series.lattice_N:
        return False
    for place, height in ((step.first, step.height_N), (step.end, -step.height_N)):
        if not 0 < place < size:
            continue
        alike = _other_steps(series, place)
        if _command_leaps(series, place) if alike is None else alike.size < FEWEST_ALIKE:
            return False
        told = []
        for window_s in WINDOWS_S:
            near = int(window_s / series.dt_s)
            if near < 5 or place < near or place > size - near:
                continue
            jumps = _jumps(values, near)
            usual = _usual(jumps) if alike is None else max(_usual(jumps), _usual(jumps[_inside(alike - near, jumps)]))
            told.append((height + float(jumps[place - near]) if place - near < jumps.size else height, usual))
        if not told:
            return False
        if max(abs(jump) / usual for jump, usual in told) < CLEAR:
            return False
        if any(abs(jump - height) > LIKE_THE_STEP * abs(height) + CHANCE * usual for jump, usual in told):
            return False
    return 0 < step.first < size or 0 < step.end < size


def _command_leaps(series: Series, place: int) -> bool:
    """Whether the command moves at a sample as far as it hardly ever does: what jumps there answers to it."""
    near = max(round(LEAPS_WITHIN_S / series.dt_s), 2)
    starts = np.arange(0, series.time_s.size - 2 * near, near)
    moves = np.array([np.ptp(series.command_V[first : first + 2 * near]) for first in starts])
    here = float(np.ptp(series.command_V[max(place - near, 0) : place + near]))
    return moves.size > 0 and here > max(LEAP * float(moves.max()), BEYOND_IT * float(np.percentile(moves, RARE)))


def _other_steps(series: Series, place: int) -> Index | None:
    """Where else the command steps from one sample to the next, if it does near a sample; None where it does not."""
    moves = np.abs(np.diff(series.command_V))
    steps = np.flatnonzero(moves > STEPS_BY * np.ptp(series.command_V))
    away_s = np.abs(steps - place) * series.dt_s
    return steps[away_s > APART_S] if (away_s < LEAPS_WITHIN_S).any() else None


def _inside(places: Index, jumps: Array) -> Index:
    return places[(places >= 0) & (places < jumps.size)]


def _usual(jumps: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(jumps))), 1e-300) if jumps.size else np.inf
