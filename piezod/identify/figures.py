"""Figures of a fit on what it was fitted to and on what was held out, side by side."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms
from piezod.model.parameters import FitFigures

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """Samples of a recording, measured and simulated.

    Parameters
    ----------
    u, y, error
        Input, output, and measured less simulated output, shape (N,).
    """

    u: Array
    y: Array
    error: Array


def fit_figures(fitted: Sequence[Run], held_out: Sequence[Run]) -> FitFigures:
    """Figures of both.

    Parameters
    ----------
    fitted, held_out
        One run for each recording.
    """
    figures: dict[str, float | None] = {}
    loops: dict[
        tuple[int, ...], float | None
    ] = {}  # of what was measured: the same where every sample is held out once
    for name, runs in (("fit", fitted), ("held_out", held_out)):
        measured, error = _joined([run.y for run in runs]), _joined([run.error for run in runs])
        inputs, outputs = [run.u for run in runs], [run.y for run in runs]
        figures[f"rms_{name}"] = rms(error)
        figures[f"max_{name}"] = largest(error)
        figures[f"nrmse_percent_{name}"] = nrmse_percent(measured, measured - error)
        same = tuple(map(id, (*inputs, *outputs)))
        if same not in loops:
            loops[same] = _widest_loop(inputs, outputs)
        figures[f"max_hysteresis_percent_{name}"] = loops[same]
        modelled = [run.y - run.error for run in runs]
        figures[f"remaining_hysteresis_percent_{name}"] = _widest_loop(modelled, outputs)
    return FitFigures(**{key: value if value is None else float(f"{value:.6g}") for key, value in figures.items()})


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _widest_loop(drives: Sequence[Array], responses: Sequence[Array]) -> float | None:
    """Max hysteresis of the recordings, None where none of them closes a loop."""
    openings = []
    for drive, response in zip(drives, responses, strict=True):
        with contextlib.suppress(ValueError):
            openings.append(max_hysteresis_percent(drive, response))
    return max(openings, default=None)
