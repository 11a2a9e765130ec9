"""Normal equations of the output error, summed piece by piece, separately for each group of input bands.

    e = y - F(v),   v = sum_i s_i (z_i - z_{i+1}) + c,   F = origin + sum_j s'_j (S_j(v) - S_{j+1}(v))

The parameters are p = [play slopes, c, a drift for each recording with a clock, dead-zone slopes]. The range of the
input is cut into bands, which are assigned to the groups in turn. Bands of the input are held out, not stretches of
time: in periodic work every stretch of time repeats the loops of the others. The error of a fit without a group follows
from these sums without the samples.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.fit.columns import CHUNK, PlaySegments, Samples, Structure, clocks_of, zone_segments

GROUPS = 8  # groups of bands; each is held out once
BANDS = 16  # Bands of the input's range. On concealed plants 16 gave smaller errors on new recordings than 8, 24 and 32
STILL_OVER = 64 * CHUNK  # number of first samples from which the mean speed of the input is computed
STILL = 0.005  # share of its swing that the input may move within samples that are averaged


@dataclass(frozen=True)
class Piece:
    """Successive samples of a group, or means over them."""

    segments: Array  # z_i - z_{i+1}, shape (R, plays) [input unit]
    y: Array  # output, shape (R,) [output unit]
    drifts: Array  # clock of the recording in its own column, shape (R, clocks) [1]
    group: int  # group number, from 0
    samples: int = 1  # number of samples per row


def group_of(u: Array) -> NDArray[np.int64]:
    """Group of each sample of a recording, from its input, shape (N,)."""
    low, swing = float(u.min()), float(np.ptp(u)) or 1.0
    return np.minimum(BANDS * (u - low) / swing, BANDS - 1).astype(np.int64) % GROUPS


def pieces_of(structure: Structure, recordings: Sequence[Samples], every: int = 1) -> Iterator[Piece]:
    """Play segments and output of the samples that count.

    Parameters
    ----------
    every
        Samples per row, at least 1. A row is their mean if the input hardly moves within them, else the first sample.
    """
    clocks, number = clocks_of(recordings), 0
    for samples in recordings:
        plays = PlaySegments(structure.play_thresholds)
        plays.run(np.array(samples.path))
        moved = float(np.mean(np.abs(np.diff(samples.u[:STILL_OVER])))) * every
        averaged = every > 1 and moved <= STILL * float(np.ptp(samples.u))
        groups = group_of(samples.u)
        for start in range(0, samples.u.size, CHUNK):
            part = slice(start, start + CHUNK)
            segments, counts = plays.run(samples.u[part]), samples.counts[part]
            if not counts.any():
                continue
            drifts = np.zeros((segments.shape[0], clocks))
            if samples.clock is not None:
                drifts[:, number] = samples.clock[part]
            rows = _rows(np.hstack((segments, drifts, samples.y[part, None]))[counts], every, averaged)
            numbers = groups[part][counts][::every][: rows.shape[0]]
            for group in np.unique(numbers).tolist():
                members = rows[numbers == group]
                yield Piece(
                    members[:, : structure.plays], members[:, -1], members[:, structure.plays : -1], group, every
                )
        number += samples.clock is not None


def merged(pieces: Iterable[Piece]) -> list[Piece]:
    """Join the pieces of each group, all with equal `samples`; repeated sums are then faster."""
    groups: dict[int, list[Piece]] = defaultdict(list)
    for piece in pieces:
        groups[piece.group].append(piece)
    return [
        Piece(
            np.concatenate([piece.segments for piece in group]),
            np.concatenate([piece.y for piece in group]),
            np.concatenate([piece.drifts for piece in group]),
            number,
            group[0].samples,
        )
        for number, group in groups.items()
    ]


def _rows(rows: Array, every: int, averaged: bool) -> Array:
    """Means over `every` rows, or every so many rows."""
    used = rows.shape[0] - rows.shape[0] % every
    if every == 1 or not averaged or not used:
        return rows[::every]
    result: Array = rows[:used].reshape(-1, every, rows.shape[1]).mean(axis=1)
    return result


def sums_of(pieces: Iterable[Piece], structure: Structure, zones: Array, parameters: Array) -> Blocks:
    """Sums of each group at the parameters: derivatives of the output by them, and the error as the target.

    Parameters
    ----------
    pieces
        As returned by `pieces_of` for the structure.
    zones, parameters
        Thresholds of the direct dead zones, shape (m + 1,) [input unit], and p, shape (q,).
    """
    size, plays, law = parameters.size, structure.plays, parameters.size - zones.size
    hessian, gradient = np.zeros((GROUPS, size, size)), np.zeros((GROUPS, size))
    loss, samples = np.zeros(GROUPS), np.zeros(GROUPS)
    for piece in pieces:
        v = piece.segments @ parameters[:plays] + parameters[plays]
        jacobian = np.empty((v.size, size))
        jacobian[:, plays + 1 : law] = piece.drifts
        jacobian[:, law:] = zone_segments(zones, v)
        error = piece.y - structure.origin - jacobian[:, plays + 1 :] @ parameters[plays + 1 :]
        jacobian[:, plays] = slope_at(zones, parameters[law:], v)
        np.multiply(piece.segments, jacobian[:, plays, None], out=jacobian[:, :plays])
        hessian[piece.group] += piece.samples * (jacobian.T @ jacobian)
        gradient[piece.group] += piece.samples * (jacobian.T @ error)
        loss[piece.group] += piece.samples * float(error @ error)
        samples[piece.group] += piece.samples * v.size
    return Blocks(hessian, gradient, loss, samples)


def accumulate_gram(structure: Structure, pieces: Iterable[Piece]) -> Array:
    """Sum of phi phi' with phi = [play segments, 1, drifts, -inverse dead-zone segments], shape (q, q)."""
    gram: Array = np.zeros(())
    for piece in pieces:
        zones = zone_segments(structure.zone_thresholds, piece.y - structure.origin)
        phi = np.hstack((piece.segments, np.ones((piece.y.size, 1)), piece.drifts, -zones))
        gram = gram + phi.T @ phi
    return gram


def slope_at(zones: Array, slopes: Array, v: Array) -> Array:
    """Slope of the force law at v, shape (N,); it changes at each threshold."""
    centre = int(np.flatnonzero(zones == 0.0)[0])
    passed = np.searchsorted(zones, v, side="right") - 1
    inner = np.where(v >= 0.0, passed, np.minimum(passed + 1, centre))
    result: Array = slopes[np.clip(inner, 0, zones.size - 1)]
    return result
