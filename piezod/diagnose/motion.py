"""What is left while the bench moves, beside what is left while it rests: noise does not know the difference."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.direct import lattice_step_N
from piezod.diagnose.series import Series

Array = NDArray[np.float64]

WINDOW_S, FEWEST_IN_WINDOW = 0.25, 20
QUIET, MOVING = 0.2, 0.5  # parts of the windows, by how far the force moves in them and just before
FEWEST_QUIET = 8
ALONE = 0.5  # part of the windows that count as told by themselves: neighbours are alike
STILL = 0.02  # of the usual movement: a fifth of the windows that moves more is not at rest
SURE = 4.0  # standard errors between the logarithms of both powers


@dataclass(frozen=True)
class Motion:
    """How much of a residual is there only while the bench moves.

    Parameters
    ----------
    share
        Of its power within windows of a quarter of a second, what lies above that of the quiet ones; 0 where they do
        not differ.
    quiet, moving
        Powers within such windows, in units of each recording's noise.
    """

    share: float
    quiet: float
    moving: float


def motion(series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array]) -> Motion:
    """Compare the windows in which a force rests with those in which it moves.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at.
    residuals, modelled
        Reading less simulation, and simulation; each shape (N,) [N].
    """
    quiet, moving, power, total = [], [], 0.0, 0.0
    for one, residual, model in zip(series, residuals, modelled, strict=True):
        if one.role != "recording":
            continue
        powers, moves = _windows(one, residual / one.noise_N, model)
        order = np.argsort(moves, kind="stable")
        still, fast = order[: int(QUIET * order.size)], order[int((1.0 - MOVING) * order.size) :]
        if still.size < FEWEST_QUIET or moves[still].max() > STILL * float(np.median(moves[fast])):
            continue
        quiet.append(powers[still])
        moving.append(powers[fast])
        power += float(np.sum(powers - powers[still].mean()))
        total += float(powers.sum())
    if not quiet or total <= 0.0:
        return Motion(0.0, 0.0, 0.0)
    low, high = np.concatenate(quiet), np.concatenate(moving)
    logs = np.log(low), np.log(high)
    error = float(np.sqrt(sum(one.var() / (ALONE * one.size) for one in logs)))
    believed = float(logs[1].mean() - logs[0].mean()) > SURE * max(error, 1e-12)
    return Motion(max(power / total, 0.0) if believed else 0.0, float(low.mean()), float(high.mean()))


def _windows(series: Series, residual: Array, model_N: Array) -> tuple[Array, Array]:
    """Power of a residual about its mean in every window, and how far the model moves in it and the one before."""
    size = max(int(WINDOW_S / series.dt_s), FEWEST_IN_WINDOW)
    count = series.time_s.size // size
    cut = slice(0, count * size)
    parts, there = residual[cut].reshape(count, size), series.counts[cut].reshape(count, size)
    model = model_N[cut].reshape(count, size)
    moves = np.ptp(model, axis=1)
    moves[1:] = np.maximum(moves[1:], moves[:-1])
    whole = np.asarray(there.all(axis=1))
    whole = whole & (np.arange(count) > 0)
    lattice = lattice_step_N(series) / series.noise_N
    powers = np.maximum(parts.var(axis=1), max(lattice**2 / 12.0, 1e-12))
    return powers[whole], moves[whole]
