"""From recordings to a model: prepare, judge the orders, fit, and say how good it is."""

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
from piezod.identify.order import PLAYS, ZONES, Candidate, best_of, choose, judge_orders, prune, residual
from piezod.identify.scores import rms
from piezod.identify.stretches import Stretch, Structures, leading_share, whole
from piezod.identify.suitability import check_suitable, falls
from piezod.model import Model, file_sha256
from piezod.model.parameters import Channel, FitFigures, Provenance, RecordingSource, Start
from piezod.operators import EPS, PrandtlIshlinskii
from piezod.recording import Recording
from piezod.recording.names import unit_of

Array = NDArray[np.float64]

FINE_PLAYS, FINE_ZONES = 40, 20
"""Tables of the smooth base. Twice as fine, the error on other work of three concealed plants with coloured noise falls
from 1.04, 1.08 and 1.11 of the noise to 1.03, 1.07 and 1.10; a tick takes twice as long."""

LEFT = 1.02
"""Ratio of squared errors on the other groups above which a single step has left their fit: they are fitted anew."""

LEAST_EXPLAINED = 0.5
"""Share of the output's variance below which a model leaves more than it explains."""

REPEATS = 3.0  # times the noise: an error of so much is hardly an output that has nothing to do with the input
NOTHING_LEFT = 1.1
"""Times the noise up to which an error is noise: it has 5 % of uncertainty, and the model some of its own."""

WORSE_START = 1.5
"""Times the error of the rest that the first samples may show before they are left out."""


@dataclass(frozen=True)
class Options:
    """How to identify.

    Parameters
    ----------
    input, output
        Columns of the recordings.
    plays, zones
        n and m; None: the fewest that fit as well as the smooth base, or with `orders` the pair with the least
        held-out error.
    orders
        Whether every pair of orders is judged, as in the thesis. So it is too where only one of n and m is given, or
        variant A.
    variant
        "A": no play weight negative; "B": no partial sum below eps.
    eps
        Smallest partial sum.
    prune
        Whether operators that hardly matter are dropped.
    fit_share
        With given or judged orders: leading share of each recording that is fitted; the rest is held out.
    name
        Of the model.
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
    """A model and how it was come by.

    Parameters
    ----------
    model
        The chosen one.
    candidates
        Every pair of orders that was judged.
    taken
        The pair of orders that was taken.
    chosen
        The same after pruning: what the model was made of.
    notes
        What the recordings cannot determine, and what was noticed in them.
    noise
        Noise of the recordings; None: they do not tell it.
    """

    model: Model
    candidates: list[Candidate]
    taken: Candidate
    chosen: Candidate
    notes: list[str]
    noise: Noise | None = None

    @property
    def explained(self) -> float:
        """Share of the output's variance that the model predicts where it is held out; below 0 where it harms."""
        fit = self.model.provenance.fit
        return 1.0 - (1.0 - 0.01 * (fit.nrmse_percent_held_out or 0.0)) ** 2

    @property
    def useful(self) -> bool:
        """Whether the model explains more than it leaves."""
        return self.explained > LEAST_EXPLAINED

    @property
    def verdict(self) -> str:
        """In a sentence, how good the model is."""
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
                if error < NOTHING_LEFT * self.noise.rms
                else "piezod diagnose tells what is left"
            )
            return f"{words}; noise {self.noise.rms:.3g} {unit}, seen in {self.noise.seen_in}; {rest}"
        if self.useful:
            return words
        needs = f"not usable: {words}, must explain more than {100.0 * LEAST_EXPLAINED:.0f} %"
        if self.noise is not None and error > REPEATS * self.noise.rms:
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
        At least one, all with the same input and output columns; such as `load_recordings` gives.
    options
        Columns, orders, constraints.
    by
        Program and version, for the provenance.
    sources, notes
        What taking them in found; without sources the recordings' files are hashed here.
    on_step
        Called with what is done and the share of the pairs of orders that is judged.

    Raises
    ------
    RecordingError
        A recording determines no model; the message says what to record instead.
    """
    said = list(notes)
    if all(falls(recording, options.input, options.output) for recording in recordings):
        said.append(
            f"{recordings[0].source}: {options.output} falls where {options.input} rises: the model is of the negative "
            f"-{options.output}; to drive the bench, turn the sign of the load cell (registers.force.scale) and record "
            "again"
        )
        options = replace(options, output=f"-{options.output}")
    pairs = [(r.channel(options.input), r.channel(options.output)) for r in recordings]
    said += [w for one in recordings for w in check_suitable(one, options.input, options.output)]
    if not 0.1 <= options.fit_share <= 0.95:
        raise UsageError(f"the fitted share is {options.fit_share:g}, must be within 0.1 and 0.95")
    by_orders = options.orders or options.plays is not None or options.zones is not None or options.variant == "A"
    on_step("fitting", 0.0 if by_orders else None)
    if not by_orders:
        return _smooth(recordings, pairs, options, by, sources, said)
    stretches = [
        leading_share(recording, u, y, options.input, options.fit_share, options.eps)
        for recording, (u, y) in zip(recordings, pairs, strict=True)
    ]
    fitted, held_out = [one.fitted for one in stretches], [one.held_out for one in stretches]
    orders = [
        (n, m)
        for n in ((options.plays,) if options.plays is not None else PLAYS)
        for m in ((options.zones,) if options.zones is not None else ZONES)
    ]
    structures = Structures(stretches)
    judged = itertools.count()

    def structure_of(plays: int, zones: int) -> Structure:
        on_step("fitting", next(judged) / len(orders))
        return structures.of(plays, zones)

    candidates = judge_orders(structure_of, fitted, held_out, orders=orders, variant=options.variant, eps=options.eps)
    taken = chosen = choose(candidates)
    if options.prune:
        chosen = prune(taken, best_of(candidates), fitted, held_out, variant=options.variant, eps=options.eps)
    assert chosen.fit is not None
    operator = chosen.fit.hysteresis.operator()
    figures = fit_figures(*([_run(operator, samples) for samples in part] for part in (fitted, held_out)))
    model = _model(recordings, pairs, options, chosen.fit, stretches[0], figures, by, sources, said)
    said += [note for one in stretches for note in one.notes]
    return Identification(model, candidates, taken, chosen, said + _undetermined(chosen), _noise(recordings, fitted))


def _smooth(
    recordings: Sequence[Recording],
    pairs: Sequence[tuple[Array, Array]],
    options: Options,
    by: str,
    sources: Sequence[RecordingSource],
    said: list[str],
) -> Identification:
    """The fewest operators that fit as well as the smooth base; every sample counts."""
    stretches = [
        whole(recording, u, y, options.input, options.eps) for recording, (u, y) in zip(recordings, pairs, strict=True)
    ]
    base = _base(stretches, options.eps)
    unsettled = [_without_unsettled(recording, one, base) for recording, one in zip(recordings, stretches, strict=True)]
    if any(new is not old for new, old in zip(unsettled, stretches, strict=True)):
        stretches = unsettled
        base = _base(stretches, options.eps)
    fitted = [one.fitted for one in stretches]
    loss = sum(float(np.sum(_run(fit_of_base(base).hysteresis.operator(), one).error ** 2)) for one in fitted)
    fewest = reduced(base, fitted, loss)
    fit = fit_of_base(fewest)
    figures = fit_figures([_run(fit.hysteresis.operator(), one) for one in fitted], _held_out(fewest, fitted))
    plays, zones = fit.structure.plays - 1, fit.structure.zones
    chosen = Candidate(
        plays, zones, fit, figures.rms_fit or 0.0, figures.rms_held_out or 0.0, np.array([figures.rms_held_out or 0.0])
    )
    said += [note for one in stretches for note in one.notes]
    model = _model(recordings, pairs, options, fit, stretches[0], figures, by, sources, said)
    noise = _noise(recordings, fitted)
    return Identification(model, [], chosen, chosen, said + _undetermined(chosen), noise)


def _noise(recordings: Sequence[Recording], fitted: Sequence[Samples]) -> Noise | None:
    """Noise of all recordings that tell it, by rms."""
    told = [noise_of(one.u, one.y, one.counts, rec.dt_s) for rec, one in zip(recordings, fitted, strict=True)]
    known = [(noise, one.u.size) for noise, one in zip(told, fitted, strict=True) if noise is not None]
    if not known:
        return None
    power = sum(noise.rms**2 * size for noise, size in known) / sum(size for _, size in known)
    return Noise(float(np.sqrt(power)), known[0][0].seen_in)


def _base(stretches: Sequence[Stretch], eps: float) -> Base:
    tables = Structures(stretches).smooth(FINE_PLAYS, FINE_ZONES)
    return fit_smooth_base(*tables, [one.fitted for one in stretches], eps)


def _without_unsettled(recording: Recording, stretch: Stretch, base: Base) -> Stretch:
    """The same without its first samples, where these fit worse than the rest: no start that was tried is theirs."""
    first, samples = stretch.unsettled, stretch.fitted
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
    kept = replace(samples, counts=counts)
    return Stretch(kept, kept, stretch.at_rest, 0, (*stretch.notes, note))


def _held_out(base: Base, recordings: Sequence[Samples]) -> list[Run]:
    """Every group of bands as the fit of the others simulates it; start and penalty have seen all groups."""
    groups = [group_of(one.u).astype(np.int8) for one in recordings]
    powers = sum(map(_powers, _errors(base, base.parameters, recordings), recordings, groups))
    held_out = [np.zeros(one.u.size) for one in recordings]
    for group in range(GROUPS):
        rest = np.arange(GROUPS) != group
        errors = _errors(base, base.without(group), recordings)
        if not np.sum(sum(map(_powers, errors, recordings, groups)), where=rest) <= LEFT * np.sum(powers, where=rest):
            others = [
                replace(one, counts=one.counts & (its != group)) for one, its in zip(recordings, groups, strict=True)
            ]
            again = refit(base.structure, base.zones, others, base.eps, base.parameters, base.penalty)
            errors = _errors(base, again.parameters, recordings)
        for kept, error, its in zip(held_out, errors, groups, strict=True):
            np.copyto(kept, error, where=its == group)
    return [_counted(one, error) for one, error in zip(recordings, held_out, strict=True)]


def _errors(base: Base, parameters: Array, recordings: Sequence[Samples]) -> list[Array]:
    """Of a fit with other parameters, over every sample of each recording [output unit]."""
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
        statistics=fit.statistics,
    )


def _start(path: tuple[float, ...], *, at_rest: bool) -> Start:
    """What a drive from zero starts with, when it starts as the first recording did."""
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
    """Slopes whose column is nearly empty: the recording hardly reaches there."""
    assert chosen.fit is not None
    gram, structure = chosen.fit.gram, chosen.fit.structure
    lengths = np.sqrt(np.diag(gram)[: structure.plays])
    weak = np.flatnonzero(lengths < 1e-3 * lengths.max())
    return [f"plays above {structure.play_thresholds[k]:.3g} are hardly moved by these recordings" for k in weak[:1]]
