"""Steps of the load: spans of time with a shifted reading, and a test of their edges."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Index
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.estimation.fit.blocks import whitening
from piezod.estimation.recordings.noise import MEDIAN_SPREAD
from piezod.estimation.recordings.series import Series

NEVER_S = 1e7  # end of a step that stays
CELLS = 400  # cells of a recording whose edges are tried first
CELL_DISTANCE = 4  # least distance between the edges of two proposals [cells]
SHORTEST = 2  # shortest step [cells]
MOST_STEPS = 2  # proposals for a recording
WINDOWS_S = (0.1, 0.3, 1.0, 3.0)  # windows before and after an edge whose means are compared
JUMP_S = 0.3  # window before and after the largest jump
COMMAND_JUMPS = 20  # jumps of the command that are skipped
EDGE_WITHIN_S, EDGE_WINDOW_S = 0.25, 0.5  # search range for an edge around its first estimate, and window of its levels
CLEAR = 5.0  # least jump at an edge, in standard deviations of jumps elsewhere
HEIGHT_TOLERANCE = 0.4  # largest difference of jump and height, relative to the height
DEVIATIONS = 2.0  # further allowed difference, in standard deviations of jumps elsewhere
LEAST_STEP = 0.5  # least height over the step of a coarse converter; rounding causes lower steps
COMMAND_NEAR_S, LARGEST_SHARE = 0.05, 0.5  # window around an edge; least command jump over its largest motion
RARE, BEYOND_RARE = 90.0, 1.5  # percentile of the command's motions; least jump over it: a sine has no such motion
COMMAND_STEP, STEP_DISTANCE_S, FEWEST_STEPS = 0.1, 0.5, 5  # step over the range; distance and number of other steps


@dataclass(frozen=True)
class Step:
    """Shift of the reading by `height_N` [N] from sample `first` to `end`; `end` is the last one if the step stays."""

    height_N: float
    first: int
    end: int


def likely_steps(normal: Normal, number: int) -> list[Step]:
    """Steps that would lower the squared residual most, with everything else refitted to first order.

    `number`: number of the recording. The at most `MOST_STEPS` steps share no edge.
    """
    series, rows = normal.chain.series[number], normal.chain.rows[number]
    size, step = normal.weights[number].size, rows.step or 1
    sums = _Sums.of(normal, number)
    edges = np.unique(np.linspace(0, size, CELLS + 1).astype(int))
    gains = sums.gains(edges[:, None], edges[None, :])
    index = np.arange(edges.size)
    gains[index[None, :] - index[:, None] < SHORTEST] = 0.0
    steps: list[Step] = []
    while len(steps) < MOST_STEPS:
        a, b = (int(x) for x in np.unravel_index(int(np.argmax(gains)), gains.shape))
        if gains[a, b] <= 0.0:
            break
        first, end = _refined(sums, edges, a, b)
        height_N = sums.height_N(first, end)
        samples = series.time_s.size
        steps.append(Step(height_N, first * step, samples if end == size else min(end * step, samples)))
        gains[max(a - CELL_DISTANCE, 0) : a + CELL_DISTANCE + 1, :] = 0.0
        gains[:, max(b - CELL_DISTANCE, 0) : b + CELL_DISTANCE + 1] = 0.0
    return steps


def jump_steps(series: Series, residual_N: Array) -> list[Step]:
    """Steps from the largest jump of a residual without a jump of the command: one that stays, one until a jump back.

    `likely_steps` may place an edge wrongly while another effect is missing.
    """
    near, size = round(JUMP_S / series.dt_s), series.time_s.size
    if near < 5 or size < 4 * near:
        return []
    jumps = _jumps(np.where(series.counts, residual_N, 0.0), near)
    clear = CLEAR * _spread(jumps)
    place, height_N = _largest(series, jumps, near)
    if abs(height_N) < clear:
        return []
    steps = [Step(height_N, place, size)]
    back, back_N = _largest(series, -np.sign(height_N) * jumps, near, signed=True)
    if back > place and back_N > max(clear, (1.0 - HEIGHT_TOLERANCE) * abs(height_N)):
        steps.append(Step(height_N, place, back))
    return steps


def _jumps(values: Array, near: int) -> Array:
    """Mean of the `near` values from each sample on minus the mean of those before it, shape (N - 2 near,)."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    middles = np.arange(near, values.size - near)
    jumps: Array = (total[middles + near] - 2.0 * total[middles] + total[middles - near]) / near
    return jumps


def _largest(series: Series, jumps: Array, near: int, *, signed: bool = False) -> tuple[int, float]:
    """Sample and height of the largest jump without a jump of the command."""
    sizes = jumps.copy() if signed else np.abs(jumps)
    for _ in range(COMMAND_JUMPS):
        k = int(np.argmax(sizes))
        if not _command_jumps(series, k + near):
            break
        sizes[max(k - near, 0) : k + near] = -np.inf
    return k + near, float(jumps[k])


def _refined(sums: "_Sums", edges: Array, a: int, b: int) -> tuple[int, int]:
    """First sample and end with the largest gain near two cell edges; each edge is searched in turn, twice."""
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
    """Running sums; the sums over a span are differences of them."""

    along: Array  # products of a step with the residual, shape (N + 1,)
    length: Array  # squared norms of a step, shape (N + 1,)
    across: Array  # products of a step with the fitted columns, whitened by the normal equations, shape (N + 1, P)
    gradient: Array  # gradient of the fitted parameters, whitened, shape (P,)

    @classmethod
    def of(cls, normal: Normal, number: int) -> "_Sums":
        hessian, gradient = normal.total
        whiten = whitening(hessian)
        change = normal.trust[number] / normal.chain.series[number].noise_N  # derivative of the residual by the height
        columns = (normal.weights[number] * change)[:, None] * normal.jacobians[number]
        return cls(
            np.concatenate(([0.0], np.cumsum(normal.weighted[number] * change))),
            np.concatenate(([0.0], np.cumsum(normal.weights[number] * change**2))),
            np.vstack((np.zeros(whiten.shape[1]), np.cumsum(columns, axis=0))) @ whiten,
            gradient @ whiten,
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
    """Time near `at_s` at which two levels, one before and one after, fit a residual best [s].

    `without_N`: residual without the step, shape (N,) [N].
    """
    dt_s, size = series.dt_s, series.time_s.size
    middle, reach, near = round(at_s / dt_s), round(EDGE_WITHIN_S / dt_s), round(EDGE_WINDOW_S / dt_s)
    first, end = max(middle - reach - near, 0), min(middle + reach + near, size)
    values, counts = without_N[first:end], series.counts[first:end].astype(np.float64)
    places = np.arange(max(middle - reach, first + 2), min(middle + reach, end - 2))
    if places.size == 0 or not counts.any():
        return at_s
    sums, numbers = np.cumsum(np.where(counts > 0.0, values, 0.0)), np.cumsum(counts)
    before, count = sums[places - first - 1], numbers[places - first - 1]
    explained = before**2 / np.maximum(count, 1.0) + (sums[-1] - before) ** 2 / np.maximum(numbers[-1] - count, 1.0)
    return float(places[int(np.argmax(explained))]) * dt_s


def shown_late_s(chain: Chain, terms: Sequence[Term], point: Point) -> float:
    """Delay from an edge of the load to the reading, by the effects behind the mechanics [s].

    The last term of the hypothesis is the step.
    """
    number, values = terms[-1].series, point.values[-1]
    time_s = chain.series[number].time_s
    without = replace(point, values=(*point.values[:-1], {**values, "step_N": 0.0}))
    change_N = chain.run(number, terms, point).reading_N - chain.run(number, terms, without).reading_N
    part = change_N / values["step_N"] if values["step_N"] else np.zeros(time_s.size)
    edge_s = values["on_s"]
    if not 0.0 < edge_s < time_s[-1]:
        part, edge_s = 1.0 - part, values["off_s"]
    after = int(np.searchsorted(time_s, edge_s))
    beyond_half = np.flatnonzero(part[after:] >= 0.5)
    if after == 0 or beyond_half.size == 0:
        return 0.0
    k = after + int(beyond_half[0])
    half_s = float(np.interp(0.5, part[k - 1 : k + 1], time_s[k - 1 : k + 1]))
    return max(half_s - edge_s - 0.5 * values["rise_s"], 0.0)


def has_clear_edges(series: Series, residual_N: Array, step: Step) -> bool:
    """Whether the reading jumps by the height of the step at its edges, more than elsewhere and without the command.

    `residual_N`: residual with the step, shape (N,) [N].
    """
    values = np.where(series.counts, residual_N, 0.0)
    size = values.size
    if abs(step.height_N) < LEAST_STEP * series.lattice_N:
        return False
    for place, height in ((step.first, step.height_N), (step.end, -step.height_N)):
        if not 0 < place < size:
            continue
        other_steps = _other_steps(series, place)
        if _command_jumps(series, place) if other_steps is None else other_steps.size < FEWEST_STEPS:
            return False
        jumps_and_spreads = []
        for window_s in WINDOWS_S:
            near = int(window_s / series.dt_s)
            if near < 5 or place < near or place > size - near:
                continue
            jumps = _jumps(values, near)
            spread = _spread(jumps)
            if other_steps is not None:
                spread = max(spread, _spread(jumps[_inside(other_steps - near, jumps)]))
            jump = height + float(jumps[place - near]) if place - near < jumps.size else height
            jumps_and_spreads.append((jump, spread))
        if not jumps_and_spreads or max(abs(jump) / spread for jump, spread in jumps_and_spreads) < CLEAR:
            return False
        tolerance = HEIGHT_TOLERANCE * abs(height)
        if any(abs(jump - height) > tolerance + DEVIATIONS * spread for jump, spread in jumps_and_spreads):
            return False
    return 0 < step.first < size or 0 < step.end < size


def _command_jumps(series: Series, place: int) -> bool:
    """Whether the command moves unusually far at a sample; a jump of the reading there is its answer."""
    near = max(round(COMMAND_NEAR_S / series.dt_s), 2)
    starts = np.arange(0, series.time_s.size - 2 * near, near)
    moves = np.array([np.ptp(series.command_V[first : first + 2 * near]) for first in starts])
    if not moves.size:
        return False
    largest, rare = float(moves.max()), float(np.percentile(moves, RARE))
    return float(np.ptp(series.command_V[max(place - near, 0) : place + near])) > max(
        LARGEST_SHARE * largest, BEYOND_RARE * rare
    )


def _other_steps(series: Series, place: int) -> Index | None:
    """Other samples at which the command steps, if it steps near this sample; otherwise None."""
    moves = np.abs(np.diff(series.command_V))
    steps = np.flatnonzero(moves > COMMAND_STEP * np.ptp(series.command_V))
    distance_s = np.abs(steps - place) * series.dt_s
    return steps[distance_s > STEP_DISTANCE_S] if (distance_s < COMMAND_NEAR_S).any() else None


def _inside(places: Index, jumps: Array) -> Index:
    return places[(places >= 0) & (places < jumps.size)]


def _spread(jumps: Array) -> float:
    """Standard deviation from the median absolute jump."""
    return max(MEDIAN_SPREAD * float(np.median(np.abs(jumps))), 1e-300) if jumps.size else np.inf
