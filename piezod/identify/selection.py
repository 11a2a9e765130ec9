"""Selection of the orders: by held-out errors, as in the thesis, or by a reduction of the smooth base."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.base.reduction import reduced
from piezod.estimation.base.smooth_base import Base, fit_smooth_base, refit
from piezod.estimation.fit.columns import Samples
from piezod.estimation.fit.normal_equations import GROUPS, group_of
from piezod.estimation.recordings.intake import OnStep
from piezod.identify.fit import fit_of_base
from piezod.identify.options import Options
from piezod.identify.order import PLAYS, ZONES, Candidate, best_of, candidate_of, choose, prune, residual
from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms
from piezod.identify.stretches import Stretch, Structures, split_stretch, unsplit_stretch
from piezod.model.parameters import FitFigures
from piezod.operators import PrandtlIshlinskii
from piezod.recording import Recording

FINE_PLAYS, FINE_ZONES = 40, 20
"""Tables of the smooth base. Twice as fine, the error on new recordings of three concealed plants with coloured noise
falls from 1.04, 1.08 and 1.11 of the noise to 1.03, 1.07 and 1.10; a tick takes twice as long."""

MOST_GROWTH = 1.02
"""Growth of the squared error on the other groups above which a single step is too inexact and a full refit follows."""

WORSE_START = 1.5
"""Largest error of the first samples, in multiples of the error of the other samples, before they are excluded."""


@dataclass(frozen=True)
class Run:
    """Input, measured output, and measured minus simulated output of a recording, each shape (N,)."""

    u: Array
    y: Array
    error: Array


@dataclass(frozen=True)
class Selection:
    """Chosen orders, with the compared ones, the stretches of the recordings and the figures of the fit."""

    stretches: list[Stretch]
    candidates: list[Candidate]
    before_pruning: Candidate
    chosen: Candidate
    figures: FitFigures


def select_by_orders(
    recordings: Sequence[Recording], pairs: Sequence[tuple[Array, Array]], options: Options, on_step: OnStep
) -> Selection:
    """Orders with the least held-out error, as in the thesis."""
    stretches = [
        split_stretch(recording, u, y, options.input, options.fit_share, options.eps)
        for recording, (u, y) in zip(recordings, pairs, strict=True)
    ]
    fitted, held_out = [stretch.fitted for stretch in stretches], [stretch.held_out for stretch in stretches]
    orders = [
        (n, m)
        for n in ((options.plays,) if options.plays is not None else PLAYS)
        for m in ((options.zones,) if options.zones is not None else ZONES)
    ]
    structures = Structures(stretches)
    candidates = []
    for done, (n, m) in enumerate(orders):
        on_step("fitting", done / len(orders))
        structure = structures.of(n, m)
        candidates.append(candidate_of(structure, n, m, fitted, held_out, options.variant, options.eps))
    before_pruning = chosen = choose(candidates)
    if options.prune:
        chosen = prune(chosen, best_of(candidates), fitted, held_out, variant=options.variant, eps=options.eps)
    assert chosen.fit is not None
    operator = chosen.fit.hysteresis.operator()
    figures = _figures(*([_run(operator, samples) for samples in part] for part in (fitted, held_out)))
    return Selection(stretches, candidates, before_pruning, chosen, figures)


def reduce_smooth_base(
    recordings: Sequence[Recording], pairs: Sequence[tuple[Array, Array]], options: Options
) -> Selection:
    """The fewest operators that fit as well as the smooth base; every sample counts."""
    stretches = [
        unsplit_stretch(recording, u, y, options.input, options.eps)
        for recording, (u, y) in zip(recordings, pairs, strict=True)
    ]
    base = _base(stretches, options.eps)
    trimmed = [_without_uncertain(recording, s, base) for recording, s in zip(recordings, stretches, strict=True)]
    if any(new is not old for new, old in zip(trimmed, stretches, strict=True)):
        stretches = trimmed
        base = _base(stretches, options.eps)
    fitted = [stretch.fitted for stretch in stretches]
    loss = sum(float(np.sum(_run(fit_of_base(base).hysteresis.operator(), samples).error ** 2)) for samples in fitted)
    fewest = reduced(base, fitted, loss)
    fit = fit_of_base(fewest)
    figures = _figures([_run(fit.hysteresis.operator(), samples) for samples in fitted], _held_out(fewest, fitted))
    rms_held_out = figures.rms_held_out or 0.0
    chosen = Candidate(
        fit.structure.plays - 1,
        fit.structure.zones,
        fit,
        figures.rms_fit or 0.0,
        rms_held_out,
        np.array([rms_held_out]),
    )
    return Selection(stretches, [], chosen, chosen, figures)


def _base(stretches: Sequence[Stretch], eps: float) -> Base:
    tables = Structures(stretches).smooth(FINE_PLAYS, FINE_ZONES)
    return fit_smooth_base(*tables, [stretch.fitted for stretch in stretches], eps)


def _without_uncertain(recording: Recording, stretch: Stretch, base: Base) -> Stretch:
    """Exclude the first samples if they fit worse than the others: then no tried start fits them."""
    first, samples = stretch.uncertain, stretch.fitted
    counts = samples.counts.copy()
    counts[:first] = False
    if not samples.counts[:first].any() or counts.sum() < 0.5 * samples.counts.sum():
        return stretch
    error = residual(fit_of_base(base).hysteresis.operator(), samples)
    if rms(error[:first][samples.counts[:first]]) < WORSE_START * rms(error[counts]):
        return stretch
    note = (
        f"{recording.source}: its first {recording.time_s[first] - recording.time_s[0]:.3g} s depend on what came "
        "before and are not used"
    )
    trimmed = replace(samples, counts=counts)
    return Stretch(trimmed, trimmed, stretch.at_rest, 0, (*stretch.notes, note))


def _held_out(base: Base, recordings: Sequence[Samples]) -> list[Run]:
    """Each group of bands, simulated by a fit of the other groups; start and penalty come from all groups."""
    groups = [group_of(samples.u).astype(np.int8) for samples in recordings]
    powers = sum(map(_powers, _errors(base, base.parameters, recordings), recordings, groups))
    held_out = [np.zeros(samples.u.size) for samples in recordings]
    for group in range(GROUPS):
        rest = np.arange(GROUPS) != group
        errors = _errors(base, base.without(group), recordings)
        power = np.sum(sum(map(_powers, errors, recordings, groups)), where=rest)
        if not power <= MOST_GROWTH * np.sum(powers, where=rest):
            others = [
                replace(samples, counts=samples.counts & (numbers != group))
                for samples, numbers in zip(recordings, groups, strict=True)
            ]
            full = refit(base.structure, base.zones, others, base.eps, base.parameters, base.penalty)
            errors = _errors(base, full.parameters, recordings)
        for result, error, numbers in zip(held_out, errors, groups, strict=True):
            np.copyto(result, error, where=numbers == group)
    return [_counted(samples, error) for samples, error in zip(recordings, held_out, strict=True)]


def _errors(base: Base, parameters: Array, recordings: Sequence[Samples]) -> list[Array]:
    """Errors of the base with other parameters, over every sample of each recording [output unit]."""
    operator = fit_of_base(replace(base, parameters=parameters)).hysteresis.operator()
    return [residual(operator, samples) for samples in recordings]


def _powers(error: Array, samples: Samples, groups: NDArray[np.int8]) -> Array:
    """Squared error of the samples that count, by group, shape (GROUPS,)."""
    result: Array = np.bincount(groups, np.where(samples.counts, error, 0.0) ** 2, GROUPS).astype(np.float64)
    return result


def _counted(samples: Samples, error: Array) -> Run:
    if samples.counts.all():
        return Run(samples.u, samples.y, error)
    return Run(samples.u[samples.counts], samples.y[samples.counts], error[samples.counts])


def _run(operator: PrandtlIshlinskii, samples: Samples) -> Run:
    return _counted(samples, residual(operator, samples))


def _figures(fitted: Sequence[Run], held_out: Sequence[Run]) -> FitFigures:
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
