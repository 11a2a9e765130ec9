"""From recordings to a model: split the samples, select the orders, fit, and compute the figures of the fit."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import UsageError
from piezod.estimation.columns import Samples, Structure
from piezod.estimation.noise import Noise, noise_of
from piezod.estimation.normal_equations import GROUPS, group_of
from piezod.estimation.quadratic_program import Variant
from piezod.estimation.reduction import reduced
from piezod.estimation.smooth_base import Base, fit_smooth_base, refit
from piezod.identify.figures import Run, fit_figures
from piezod.identify.fit import Fit, fit_of_base
from piezod.identify.intake import OnStep
from piezod.identify.order import PLAYS, ZONES, Candidate, best_of, choose, fit_orders, prune, residual
from piezod.identify.scores import rms
from piezod.identify.stretches import Stretch, Structures, split_stretch, unsplit_stretch
from piezod.identify.suitability import check_suitable, falls
from piezod.model import Model, file_sha256
from piezod.model.parameters import Channel, FitFigures, Provenance, RecordingSource, Start
from piezod.operators import EPS, PrandtlIshlinskii
from piezod.recording import Recording
from piezod.recording.names import unit_of

Array = NDArray[np.float64]

FINE_PLAYS, FINE_ZONES = 40, 20
"""Tables of the smooth base. Twice as fine, the error on new recordings of three concealed plants with coloured noise
falls from 1.04, 1.08 and 1.11 of the noise to 1.03, 1.07 and 1.10; a tick takes twice as long."""

MOST_GROWTH = 1.02
"""Growth of the squared error on the other groups above which a single step is too inexact and a full refit follows."""

LEAST_EXPLAINED = 0.5
"""Share of the output's variance that a useful model must explain."""

STRUCTURED = 3.0
"""Error, in multiples of the noise, above which an unusable model still has structured residuals."""

AT_THE_NOISE = 1.1
"""Error, in multiples of the noise, up to which no effect is missing: the noise is known to 5 %."""

WORSE_START = 1.5
"""Largest error of the first samples, in multiples of the error of the other samples, before they are excluded."""


@dataclass(frozen=True)
class Options:
    """Options of the identification.

    Parameters
    ----------
    input, output
        Columns of the recordings.
    plays, zones
        Orders n and m; None: the fewest operators that fit as well as the smooth base. With `orders`: the pair with
        the least held-out error.
    orders
        Whether every pair of orders is fitted and compared, as in the thesis. A given n or m, or variant A, implies it.
    variant
        "A": no play weight negative; "B": no partial sum below eps.
    eps
        Smallest partial sum.
    prune
        Whether operators with negligible weights are removed after a comparison of orders.
    fit_share
        After a comparison of orders: leading share of each recording that is fitted, 0.1 to 0.95; the rest is held out.
    name
        Name of the model.
    """

    input: str = "voltage_V"
    output: str = "force_N"
    plays: int | None = None
    zones: int | None = None
    orders: bool = False
    variant: Variant = "B"
    eps: float = EPS
    prune: bool = True
    fit_share: float = 0.7
    name: str = "stack"


@dataclass(frozen=True)
class Identification:
    """A model with the steps that led to it.

    Parameters
    ----------
    candidates
        Compared orders; empty after a fit of the smooth base.
    before_pruning, chosen
        Selected order, and the order of the model after pruning.
    notes
        Properties that the recordings do not determine, and properties of the recordings.
    noise
        Noise of the recordings; None: unknown.
    """

    model: Model
    candidates: list[Candidate]
    before_pruning: Candidate
    chosen: Candidate
    notes: list[str]
    noise: Noise | None = None

    @property
    def explained(self) -> float:
        """Explained share of the variance on held-out data, at most 1; below 0: worse than the mean."""
        fit = self.model.provenance.fit
        return 1.0 - (1.0 - 0.01 * (fit.nrmse_percent_held_out or 0.0)) ** 2

    @property
    def useful(self) -> bool:
        """Whether the model explains more than half of the variance."""
        return self.explained > LEAST_EXPLAINED

    @property
    def verdict(self) -> str:
        """Quality of the model in a sentence."""
        unit = self.model.output.unit
        error = self.chosen.rms_held_out
        share = 100.0 * error / (self.model.output.high - self.model.output.low)
        words = (
            f"error on held-out data {error:.3g} {unit} rms, {share:.2g} % of range; the model explains "
            f"{100.0 * self.explained:.4g} % of the output's variance"
        )
        if self.useful and self.noise is not None:
            rest = (
                "nothing else is left"
                if error < AT_THE_NOISE * self.noise.rms
                else "piezod diagnose tells what is left"
            )
            return f"{words}; noise {self.noise.rms:.3g} {unit}, seen in {self.noise.seen_in}; {rest}"
        if self.useful:
            return words
        needs = f"not usable: {words}, must explain more than {100.0 * LEAST_EXPLAINED:.0f} %"
        if self.noise is not None and error > STRUCTURED * self.noise.rms:
            return (
                f"{needs}; noise {self.noise.rms:.3g} {unit}, seen in {self.noise.seen_in}: what is left follows the "
                "input through modes, filters or delays, which no hysteresis has; piezod diagnose finds them"
            )
        return (
            f"{needs}; check that both columns "
            "belong together, or record triangles over the whole range (piezod record --excitation varying-triangles)"
        )


def identify(
    recordings: Sequence[Recording],
    options: Options,
    by: str,
    *,
    sources: Sequence[RecordingSource] = (),
    notes: Sequence[str] = (),
    on_step: OnStep = lambda *_: None,
) -> Identification:
    """Identify a model.

    Parameters
    ----------
    recordings
        At least one, as returned by `load_recordings`; all hold both columns of the options.
    by
        Program and version, for the provenance.
    sources
        Entries for the provenance; empty: computed from the recordings' files.
    notes
        Notes on the recordings, which precede those of the identification.
    on_step
        Called with the current step in words, and the share of the orders that is done; None: unknown.

    Raises
    ------
    RecordingError
        A recording determines no model; the message names a suitable recording.
    UsageError
        `fit_share` is out of range.
    """
    lines = list(notes)
    if all(falls(recording, options.input, options.output) for recording in recordings):
        lines.append(
            f"{recordings[0].source}: {options.output} falls where {options.input} rises: the model is of the negative "
            f"-{options.output}; to drive the bench, turn the sign of the load cell (registers.force.scale) and record "
            "again"
        )
        options = replace(options, output=f"-{options.output}")
    pairs = [(r.channel(options.input), r.channel(options.output)) for r in recordings]
    lines += [warning for r in recordings for warning in check_suitable(r, options.input, options.output)]
    if not 0.1 <= options.fit_share <= 0.95:
        raise UsageError(f"the fitted share is {options.fit_share:g}, must be within 0.1 and 0.95")
    by_orders = options.orders or options.plays is not None or options.zones is not None or options.variant == "A"
    on_step("fitting", 0.0 if by_orders else None)
    if not by_orders:
        return _smooth(recordings, pairs, options, by, sources, lines)
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
    done = itertools.count()

    def structure_of(plays: int, zones: int) -> Structure:
        on_step("fitting", next(done) / len(orders))
        return structures.of(plays, zones)

    candidates = fit_orders(structure_of, fitted, held_out, orders=orders, variant=options.variant, eps=options.eps)
    before_pruning = chosen = choose(candidates)
    if options.prune:
        chosen = prune(chosen, best_of(candidates), fitted, held_out, variant=options.variant, eps=options.eps)
    assert chosen.fit is not None
    operator = chosen.fit.hysteresis.operator()
    figures = fit_figures(*([_run(operator, samples) for samples in part] for part in (fitted, held_out)))
    model = _model(recordings, pairs, options, chosen.fit, stretches[0], figures, by, sources, lines)
    lines += [note for stretch in stretches for note in stretch.notes] + _undetermined(chosen)
    return Identification(model, candidates, before_pruning, chosen, lines, _noise(recordings, fitted))


def _smooth(
    recordings: Sequence[Recording],
    pairs: Sequence[tuple[Array, Array]],
    options: Options,
    by: str,
    sources: Sequence[RecordingSource],
    lines: list[str],
) -> Identification:
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
    figures = fit_figures([_run(fit.hysteresis.operator(), samples) for samples in fitted], _held_out(fewest, fitted))
    plays, zones = fit.structure.plays - 1, fit.structure.zones
    chosen = Candidate(
        plays, zones, fit, figures.rms_fit or 0.0, figures.rms_held_out or 0.0, np.array([figures.rms_held_out or 0.0])
    )
    lines += [note for stretch in stretches for note in stretch.notes]
    model = _model(recordings, pairs, options, fit, stretches[0], figures, by, sources, lines)
    noise = _noise(recordings, fitted)
    return Identification(model, [], chosen, chosen, lines + _undetermined(chosen), noise)


def _noise(recordings: Sequence[Recording], fitted: Sequence[Samples]) -> Noise | None:
    """Rms noise over the recordings whose noise is known."""
    noises = [noise_of(s.u, s.y, s.counts, recording.dt_s) for recording, s in zip(recordings, fitted, strict=True)]
    known = [(noise, samples.u.size) for noise, samples in zip(noises, fitted, strict=True) if noise is not None]
    if not known:
        return None
    power = sum(noise.rms**2 * size for noise, size in known) / sum(size for _, size in known)
    return Noise(float(np.sqrt(power)), known[0][0].seen_in)


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


def _model(
    recordings: Sequence[Recording],
    pairs: Sequence[tuple[Array, Array]],
    options: Options,
    fit: Fit,
    first: Stretch,
    figures: FitFigures,
    by: str,
    sources: Sequence[RecordingSource],
    notes: Sequence[str],
) -> Model:
    sources = tuple(sources) or tuple(
        RecordingSource(path=r.source, sha256=file_sha256(Path(r.source)), samples=int(r.time_s.size))
        for r in recordings
        if Path(r.source).is_file()
    )
    return Model(
        name=options.name,
        input=_channel(options.input, [u for u, _ in pairs]),
        output=_channel(options.output, [y for _, y in pairs]),
        hysteresis=fit.hysteresis,
        start=_start(first.fitted.path, at_rest=first.at_rest),
        provenance=Provenance(
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            by=by,
            recordings=sources,
            fit=figures,
            notes="; ".join(notes),
        ),
    )


def _start(path: tuple[float, ...], *, at_rest: bool) -> Start:
    """Start state of the model: the state in which the first recording starts, if it starts from zero."""
    if at_rest and path:
        return Start(kind="reset", peak=float(f"{path[0]:.6g}"))
    return Start()


def _channel(name: str, values: Sequence[Array]) -> Channel:
    low = min(float(np.nanmin(v)) for v in values)
    high = max(float(np.nanmax(v)) for v in values)
    return Channel(channel=name, unit=_unit(name), low=low, high=high)


def _unit(column: str) -> str:
    return unit_of(column) or column


def _undetermined(chosen: Candidate) -> list[str]:
    """Note on plays whose columns are nearly zero: the recordings hardly move them."""
    assert chosen.fit is not None
    gram, structure = chosen.fit.gram, chosen.fit.structure
    lengths = np.sqrt(np.diag(gram)[: structure.plays])
    weak = np.flatnonzero(lengths < 1e-3 * lengths.max())
    return [f"plays above {structure.play_thresholds[k]:.3g} are hardly moved by these recordings" for k in weak[:1]]
