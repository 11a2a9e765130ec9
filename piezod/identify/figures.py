"""Figures of a fit on the fitted and on the held-out samples."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms
from piezod.model.parameters import FitFigures


@dataclass(frozen=True)
class Run:
    """Input, measured output, and measured minus simulated output of a recording, each shape (N,)."""

    u: Array
    y: Array
    error: Array


def fit_figures(fitted: Sequence[Run], held_out: Sequence[Run]) -> FitFigures:
    """Figures of the fitted and the held-out runs, one run for each recording."""
    figures: dict[str, float | None] = {}
    loops: dict[tuple[int, ...], float | None] = {}  # by the identity of the measured arrays, which both may share
    for name, runs in (("fit", fitted), ("held_out", held_out)):
        measured, error = _joined([run.y for run in runs]), _joined([run.error for run in runs])
        inputs, outputs = [run.u for run in runs], [run.y for run in runs]
        figures[f"rms_{name}"] = rms(error)
        figures[f"max_{name}"] = largest(error)
        figures[f"nrmse_percent_{name}"] = nrmse_percent(measured, measured - error)
        key = tuple(map(id, (*inputs, *outputs)))
        if key not in loops:
            loops[key] = _widest_loop(inputs, outputs)
        figures[f"max_hysteresis_percent_{name}"] = loops[key]
        modelled = [run.y - run.error for run in runs]
        figures[f"remaining_hysteresis_percent_{name}"] = _widest_loop(modelled, outputs)
    return FitFigures(**{key: value if value is None else float(f"{value:.6g}") for key, value in figures.items()})


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _widest_loop(drives: Sequence[Array], responses: Sequence[Array]) -> float | None:
    """Largest hysteresis of the recordings [%]; None if no recording closes a loop."""
    openings = []
    for drive, response in zip(drives, responses, strict=True):
        with contextlib.suppress(ValueError):
            openings.append(max_hysteresis_percent(drive, response))
    return max(openings, default=None)
