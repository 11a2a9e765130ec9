"""Share of a residual that a flexible model explains: a lower bound of the share that named effects do not explain.

The flexible model (`absorber`) predicts every block of the recordings from the other blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array, Mask
from piezod.diagnose.adequacy.absorber import Columns, Event
from piezod.diagnose.adequacy.ridge import BlockPrediction, predicted_blocks
from piezod.diagnose.localisation import colour, events
from piezod.diagnose.localisation.cells import NormalisedResidual
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.recordings.noise import noise_of_input
from piezod.estimation.recordings.series import Series

SIGNIFICANT = 0.05  # largest p-value at which the prediction is subtracted before tones, jumps and bursts are sought
GAP = 0.05  # share of a block at either end that is not used: neighbouring samples are not independent


@dataclass(frozen=True)
class Guard:
    """Explainable part of a residual.

    Parameters
    ----------
    loss
        Mean square residual without its mean [noise variance].
    absorbed
        Mean square after prediction from the other blocks [noise variance].
    share
        Explainable share of the loss, (loss - absorbed) / loss, without the share of the noise of a measured command.
    p
        Probability of this share for noise: signs of log(before / after) flipped block by block.
    local_share, local_p
        Share of the loss in bursts beyond the noise of the residual's own spectrum, and its p-value.
    """

    loss: float
    absorbed: float
    share: float
    p: float
    local_share: float = 0.0
    local_p: float = 1.0


def explainable(series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array]) -> Guard:
    """Measure the explainable part of the residuals of the diagnosed recordings.

    `series` are recordings of any role; `residuals` and `modelled` have shape (N,) each [N].
    """
    recordings = [_Recording.of(known) for known in NormalisedResidual.diagnosed(series, residuals, modelled)]
    if not any(recording.residual.any() for recording in recordings):
        return Guard(0.0, 0.0, 0.0, 1.0)
    prediction = _Prediction.of(recordings, ())
    detected = _detected_events(recordings, prediction.remainders())
    if detected:
        prediction = _Prediction.of(recordings, detected)
    guard = _guard(recordings, prediction)
    return replace(guard, share=max(guard.share - _share_of_input_noise(series, recordings, guard.loss), 0.0))


def _share_of_input_noise(series: Sequence[Series], recordings: Sequence["_Recording"], loss: float) -> float:
    """Share of the loss from the noise of a measured command, which a flexible model averages over neighbours."""
    noise_V = {id(s): noise_of_input(s.command_V, s.counts, s.dt_s) for s in series}
    known = [value for value in noise_V.values() if value]
    if not known:
        return 0.0
    power, samples = 0.0, 0
    for recording in recordings:
        own_V = noise_V[id(recording.series)]
        steps_N, steps_V = np.diff(recording.modelled_N), np.diff(recording.series.command_V)
        gain = float(np.linalg.norm(steps_N)) / max(float(np.linalg.norm(steps_V)), 1e-300)
        input_noise = gain * float(np.sqrt(np.mean(np.square(known)))) if own_V is None else gain * own_V
        power += (input_noise / recording.series.noise_N) ** 2 * recording.residual.size
        samples += recording.residual.size
    return min(power / samples / loss, 1.0)


@dataclass(frozen=True)
class _Recording:
    """Normalised residual of a recording, with the edges of its blocks."""

    series: Series
    residual: Array
    modelled_N: Array
    counts: Mask
    edges: tuple[int, ...]

    @classmethod
    def of(cls, known: NormalisedResidual) -> "_Recording":
        edges = (0, *(block.stop for block in known.series.blocks))
        return cls(known.series, known.residual, known.modelled_N, known.counts, edges)

    @property
    def step(self) -> float:
        """Converter step [noise rms]."""
        return self.series.lattice_N / self.series.noise_N

    @property
    def inside(self) -> Mask:
        """Readings that count and are not in a gap between blocks, shape (N,)."""
        inside = self.counts.copy()
        for first, end in zip(self.edges[:-1], self.edges[1:], strict=True):
            gap = int(GAP * (end - first))
            inside[first : first + gap] = False
            inside[end - gap : end] = False
        return inside

    @property
    def beyond_seams(self) -> Mask:
        """Readings that count and do not follow a block edge, at which the weights of the prediction change."""
        beyond = self.counts.copy()
        for edge in self.edges[1:-1]:
            beyond[edge : edge + 1 + colour.ORDER] = False
        return beyond


@dataclass(frozen=True)
class _Prediction:
    """Flexible model of all recordings, with every block predicted from the others."""

    recordings: Sequence[_Recording]
    columns: Columns
    blocks: Blocks
    predicted: BlockPrediction

    @classmethod
    def of(cls, recordings: Sequence[_Recording], detected: Sequence[Event]) -> "_Prediction":
        columns = Columns([r.series for r in recordings], [r.modelled_N for r in recordings], detected)
        blocks = _sums(recordings, columns)
        return cls(recordings, columns, blocks, predicted_blocks(blocks, columns.levels))

    def remainders(self) -> list[Array]:
        """Residuals minus the prediction of each block, shape (N,) each.

        A prediction that is not significant is not subtracted, since it would add edges.
        """
        if self.predicted.p > SIGNIFICANT:
            return [recording.residual for recording in self.recordings]
        block = 0
        remainders = []
        for number, recording in enumerate(self.recordings):
            remainder = recording.residual.copy()
            for stretch, columns in self.columns.stretches(number, recording.edges):
                remainder[stretch] -= columns @ self.predicted.weights[block]
                block += 1
            remainders.append(np.where(recording.counts, remainder, 0.0))
        return remainders


def _sums(recordings: Sequence[_Recording], columns: Columns) -> Blocks:
    sums = []
    for number, recording in enumerate(recordings):
        inside = recording.inside
        for stretch, part in columns.stretches(number, recording.edges):
            keep = inside[stretch]
            used, residual = part[keep] / recording.series.noise_N, recording.residual[stretch][keep]
            sums.append(Blocks.of(used, residual, [slice(None)]))
    return Blocks.all_of(sums)


def _detected_events(recordings: Sequence[_Recording], remainders: Sequence[Array]) -> list[Event]:
    """Tones, tones of the gain, and jumps in the remainders."""
    detected: list[Event] = []
    for number, (recording, remainder) in enumerate(zip(recordings, remainders, strict=True)):
        dt_s, bin_Hz = recording.series.dt_s, 1.0 / (remainder.size * recording.series.dt_s)
        driven = colour.driven_bins(recording.series.command_V, recording.modelled_N)
        gain = (recording.modelled_N - recording.modelled_N.mean()) / max(float(recording.modelled_N.std()), 1e-12)
        tones_Hz = events.tones_Hz(remainder, dt_s)
        free_Hz = [f for f in tones_Hz if not driven[round(f / bin_Hz)]]
        detected += [Event("tone", number, f) for f in free_Hz]
        if recording.step <= events.COARSE * colour.spread(remainder[recording.counts]):
            # the rounding of a coarser converter beats with a periodic drive
            detected += [Event("beat", number, f) for f in tones_Hz if f not in free_Hz]
            detected += [Event("gain", number, f) for f in events.tones_Hz(remainder * gain, dt_s)]
        detected += [Event("jump", number, k * dt_s) for k in events.jumps(remainder, dt_s, recording.step)]
    return detected


def _guard(recordings: Sequence[_Recording], prediction: _Prediction) -> Guard:
    samples = float(prediction.blocks.samples.sum())
    loss = float(prediction.blocks.square.sum()) / samples
    absorbed = float(prediction.predicted.after.sum()) / samples
    bursts = [
        min(
            (
                events.bursts(values, recording.beyond_seams, recording.step)
                for values in (remainder, recording.residual)
            ),
            key=lambda burst: burst.energy,  # a burst in one only is explained by the prediction, or made by it
        )
        for recording, remainder in zip(recordings, prediction.remainders(), strict=True)
    ]
    energy = sum(float(recording.residual @ recording.residual) for recording in recordings)
    return Guard(
        loss,
        absorbed,
        1.0 - absorbed / loss,
        prediction.predicted.p,
        float(sum(burst.energy for burst in bursts)) / energy,
        min(1.0, len(bursts) * min(burst.p for burst in bursts)),
    )
