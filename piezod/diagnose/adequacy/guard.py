"""How much of a residual is explainable at all, by whatever it may be: the guard against names that explain too little.

A flexible model without physics (`absorber`) predicts every block of the recordings from the others. What it explains,
a named effect must explain too; what it explains and no name does, is unexplained.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.adequacy.absorber import Columns, Event
from piezod.diagnose.adequacy.ridge import Blocks, LeftOut, left_out
from piezod.diagnose.hypothesis.series import BLOCK_S, FEWEST_BLOCKS, MOST_BLOCKS, Series
from piezod.diagnose.localisation import colour, coordinates, events

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BELIEVED = 0.05  # chance up to which the absorber's part is taken off before tones, jumps and bursts are looked for
GAP = 0.05  # of a block at either end that neither teaches nor tests


@dataclass(frozen=True)
class Guard:
    """How much of a residual is explainable.

    Parameters
    ----------
    loss
        Mean square residual about its mean, in units of each recording's noise.
    absorbed
        The same after the absorber, every block left out.
    share
        Part of the loss that is explainable, (loss - absorbed) / loss.
    p
        Chance that it explains so much of noise: signs of log(before / after) flipped block by block.
    local_share, local_p
        What is left in bursts beyond the residual's own colour, as a part of the loss, and its chance.
    """

    loss: float
    absorbed: float
    share: float
    p: float
    local_share: float = 0.0
    local_p: float = 1.0


def explainable(
    series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array], *, seed: int = 0
) -> Guard:
    """Measure how much of a residual anything could explain.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at.
    residuals
        Reading less simulation, each shape (N,) [N].
    modelled
        Simulation, each shape (N,) [N].
    seed
        Of the sign flips.
    """
    told = [
        _Told.of(one, residual, model)
        for one, residual, model in zip(series, residuals, modelled, strict=True)
        if one.role == "recording" and one.counts.any()
    ]
    if not told or not any(one.residual.any() for one in told):
        return Guard(0.0, 0.0, 0.0, 1.0)
    look = _Look.at(told, ())
    suggested = _suggested(told, look.leftovers())
    if suggested:
        look = _Look.at(told, suggested)
    return _judged(told, look, np.random.default_rng(seed))


@dataclass(frozen=True)
class _Told:
    """A recording with its residual in units of its noise, 0 where it does not count, and the edges of its blocks."""

    series: Series
    residual: Array
    modelled_N: Array
    counts: Mask
    edges: tuple[int, ...]

    @classmethod
    def of(cls, series: Series, residual_N: Array, modelled_N: Array) -> "_Told":
        counts = series.counts & np.isfinite(residual_N)
        level = float(residual_N[counts].mean()) if counts.any() else 0.0
        residual = np.where(counts, residual_N - level, 0.0) / series.noise_N
        return cls(series, residual, modelled_N, counts, _block_edges(series))

    @property
    def inside(self) -> Mask:
        """What counts and is not in a gap between blocks, shape (N,)."""
        inside = self.counts.copy()
        for first, end in zip(self.edges[:-1], self.edges[1:], strict=True):
            gap = int(GAP * (end - first))
            inside[first : first + gap] = False
            inside[end - gap : end] = False
        return inside

    @property
    def beyond_seams(self) -> Mask:
        """What counts and is not just behind a block's first sample, where leftovers of other weights begin."""
        beyond = self.counts.copy()
        for edge in self.edges[1:-1]:
            beyond[edge : edge + 1 + colour.ORDER] = False
        return beyond


def _block_edges(series: Series) -> tuple[int, ...]:
    """The series' blocks, taken together to some seconds each."""
    wanted_s = min(max(BLOCK_S, series.duration_s / MOST_BLOCKS), series.duration_s / FEWEST_BLOCKS)
    wanted = wanted_s / series.dt_s
    edges = [0]
    for block in series.blocks:
        if block.stop - edges[-1] >= 0.99 * wanted:
            edges.append(block.stop)
    if edges[-1] != series.time_s.size:
        edges[-1] = series.time_s.size
    return tuple(edges)


@dataclass(frozen=True)
class _Look:
    """The absorber on all recordings."""

    told: Sequence[_Told]
    columns: Columns
    blocks: Blocks
    all: LeftOut

    @classmethod
    def at(cls, told: Sequence[_Told], suggested: Sequence[Event]) -> "_Look":
        columns = Columns([one.series for one in told], [one.modelled_N for one in told], suggested)
        blocks = _sums(told, columns)
        return cls(told, columns, blocks, left_out(blocks, columns.levels))

    def leftovers(self) -> list[Array]:
        """Residuals less what the absorber makes of each block without it, each shape (N,).

        What it makes of nothing is left in: it would put its own edges there.
        """
        if self.all.p(np.random.default_rng(0)) > BELIEVED:
            return [one.residual for one in self.told]
        block = 0
        result = []
        for number, one in enumerate(self.told):
            left = one.residual.copy()
            for stretch, columns in self.columns.stretches(number, one.edges):
                left[stretch] -= columns @ self.all.weights[block]
                block += 1
            result.append(np.where(one.counts, left, 0.0))
        return result


def _sums(told: Sequence[_Told], columns: Columns) -> Blocks:
    gram, product, square, samples = [], [], [], []
    for number, one in enumerate(told):
        inside = one.inside
        for stretch, part in columns.stretches(number, one.edges):
            keep = inside[stretch]
            used, residual = part[keep] / one.series.noise_N, one.residual[stretch][keep]
            gram.append(used.T @ used)
            product.append(used.T @ residual)
            square.append(float(residual @ residual))
            samples.append(float(residual.size))
    return Blocks(np.array(gram), np.array(product), np.array(square), np.array(samples))


def _suggested(told: Sequence[_Told], leftovers: Sequence[Array]) -> list[Event]:
    """Tones, tones of the gain, and jumps that the leftovers show."""
    found: list[Event] = []
    for number, (one, left) in enumerate(zip(told, leftovers, strict=True)):
        dt_s, bin_Hz = one.series.dt_s, 1.0 / (left.size * one.series.dt_s)
        driven, lattice = _driven(one), one.series.lattice_N / one.series.noise_N
        gain = (one.modelled_N - one.modelled_N.mean()) / max(float(one.modelled_N.std()), 1e-12)
        tones_Hz = events.tones_Hz(left, dt_s)
        own = [f for f in tones_Hz if not driven[round(f / bin_Hz)]]
        found += [Event("tone", number, f) for f in own]
        if lattice <= events.COARSE * colour.spread(left[one.counts]):  # a coarse lattice beats with a periodic drive
            found += [Event("beat", number, f) for f in tones_Hz if f not in own]
            found += [Event("gain", number, f) for f in events.tones_Hz(left * gain, dt_s)]
        found += [Event("jump", number, k * dt_s) for k in events.jumps(left, dt_s, lattice)]
    return found


def _driven(one: _Told) -> Mask:
    u = one.series.command_V
    direction, _ = coordinates.reversals(u)
    return colour.driven_bins(u, one.modelled_N, direction, np.abs(np.gradient(u)))


def _judged(told: Sequence[_Told], look: _Look, rng: np.random.Generator) -> Guard:
    n = float(look.blocks.samples.sum())
    loss = float(look.blocks.square.sum()) / n
    absorbed = float(look.all.after.sum()) / n
    local = [
        events.bursts(left, one.beyond_seams, one.series.lattice_N / one.series.noise_N)
        for one, left in zip(told, look.leftovers(), strict=True)
    ]
    energy = sum(float(one.residual @ one.residual) for one in told)
    return Guard(
        loss,
        absorbed,
        1.0 - absorbed / loss,
        look.all.p(rng),
        float(sum(one.energy for one in local)) / energy,
        min(1.0, len(local) * min(one.p for one in local)),
    )
