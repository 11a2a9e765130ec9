"""From recordings and a model to findings: prepare, search, judge, and say how sure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from piezod.diagnose.adequacy.guard import explainable
from piezod.diagnose.adequacy.remainder import motion
from piezod.diagnose.adequacy.unrecorded import unrecorded_input
from piezod.diagnose.candidates.rounding import unrounded
from piezod.diagnose.candidates.tones import with_tones
from piezod.diagnose.findings import Unnamed, Verdict
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.monotone import rises, unfolded
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.judgement import Diagnosis, Judgement, asked_nrmse_percent
from piezod.diagnose.prepare import Source, made_ready, stand_in
from piezod.diagnose.selection.acceptance import BETTER, counted, weighed
from piezod.diagnose.selection.given_effects import as_given
from piezod.diagnose.selection.search import OnProgress, fitted_without, instead, search, without
from piezod.diagnose.selection.search_state import Beside, Search
from piezod.diagnose.selection.stated_hold import as_told
from piezod.diagnose.selection.unnamed import fit_unnamed
from piezod.diagnose.verdict.doubt import (
    confidences,
    experiments_for,
    least_believed,
    needed,
    needless,
    not_believed,
    not_determined,
)
from piezod.diagnose.verdict.evidence import standing
from piezod.diagnose.verdict.extended import with_error
from piezod.diagnose.verdict.simulated import GivenRuns, free_run, tared_rms
from piezod.diagnose.verdict.verdict import (
    RECORD_NOISE,
    share_left,
    words_of,
)
from piezod.diagnose.verdict.words import Wording
from piezod.model import Model
from piezod.model.unnamed_law import LawStep

Array = NDArray[np.float64]

WITHOUT_NOISE: dict[Verdict, Verdict] = {"matches": "not_testable", "explained": "partly_explained"}
"""Verdicts where the noise is unknown: nobody can say then that nothing else is left."""
COSTS = 0.1  # of what was gained, or of what is left: what plays that do not fold may cost
STILL_GAINS = 0.5  # of what was gained by plays that fold: what another effect must gain without


def diagnose(
    model: Model, asked: Sequence[Source], past: Sequence[Source], notes: Sequence[str], progress: OnProgress
) -> Diagnosis:
    """Find what the model leaves out of the recordings.

    Parameters
    ----------
    model
        As it was identified.
    asked
        Recordings to explain.
    past
        Recordings that the model was identified on; none: a simulation of it replaces them.
    notes
        What was noticed so far.
    progress
        Told what is being done, and what part of the work is behind it at least.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    with threadpool_limits(1, user_api="blas"):  # fits run beside each other, and theirs would fight for the cores
        return _diagnosed(model, asked, past, notes, progress)


def _diagnosed(
    model: Model, asked: Sequence[Source], past: Sequence[Source], notes: Sequence[str], progress: OnProgress
) -> Diagnosis:
    progress("reading", 0.0)
    ready, still, noticed = made_ready([*past, *asked], model)
    said, series = [*notes, *noticed], [unrounded(one) for one in ready]
    before = GivenRuns.of(model, [*past, *asked], series)
    if not past:
        series.insert(0, stand_in(model))
        still.insert(0, [])
    frozen = {number: stretches for number, stretches in enumerate(still) if stretches}
    if not before.law_holds:
        said.append("the unnamed law of the given model makes the recordings worse, and is left out")
    asked_for = Judgement(model, [*past, *asked], series, before, frozen, said, stand_ins=int(not past))
    chain, start, given = asked_for.begun()
    result = search(chain, start, progress, given)
    result.chain.forget()
    result.chain, result.found = as_told(result.chain, result.found)
    result = rising(result)
    progress("judging what is left", 0.9)
    diagnosis = asked_for.judged(result)
    left = [one.reading_N - with_it for one, with_it in zip(diagnosis.series, diagnosis.extended, strict=True)]
    # what the full model explains stays explained when names are left out
    asked_for = replace(asked_for, frozen=standing(diagnosis.series, frozen, left))
    surest = confidences(diagnosis.findings)
    while True:
        idle = needless(result, diagnosis.findings, delivered=diagnosis.model is not model)
        open_sizes = [] if idle else not_determined(diagnosis.findings)
        doubtful = idle or open_sizes or least_believed(result, diagnosis.findings, surest)
        if not doubtful:
            break
        progress("leaving out what is doubtful", 0.95)
        wording = Wording(model.input.unit, model.output.unit)
        said += experiments_for(diagnosis.findings, open_sizes, wording) or not_believed(diagnosis.findings, doubtful)
        result = rising(_without(result, doubtful))
        without_them = asked_for.judged(result)
        if not (idle or open_sizes) and needed(diagnosis.findings, without_them.findings):
            break
        diagnosis, surest = without_them, confidences(without_them.findings, surest)
    if diagnosis.findings.verdict in ("unexplained", "partly_explained"):
        progress("looking for a law without a name", 0.97)
        diagnosis = with_unrecorded(with_unnamed(diagnosis, before.places))
    return diagnosis if diagnosis.findings.noise_is_known else _with_unknown_noise(diagnosis)


def _with_unknown_noise(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis without a verdict that would need the noise."""
    findings, model = diagnosis.findings, diagnosis.model
    verdict = WITHOUT_NOISE.get(findings.verdict, findings.verdict)
    findings = replace(findings, verdict=verdict, notes=(*findings.notes, RECORD_NOISE))
    findings = replace(findings, words=words_of(findings, Wording(model.input.unit, model.output.unit)))
    return replace(diagnosis, findings=findings)


def with_unrecorded(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis with an input that is not recorded, where what is left speaks for one and no law was found."""
    findings, model = diagnosis.findings, diagnosis.model
    if findings.law is not None:
        return diagnosis
    left = [one.reading_N - by for one, by in zip(diagnosis.series, diagnosis.extended, strict=True)]
    judging = [one.as_judged() for one in diagnosis.series]
    unrecorded = unrecorded_input(judging, left, diagnosis.extended, findings.explainable)
    findings = replace(findings, unrecorded=unrecorded)
    findings = replace(findings, words=words_of(findings, Wording(model.input.unit, model.output.unit)))
    return replace(diagnosis, findings=findings)


def with_unnamed(diagnosis: Diagnosis, places: Sequence[tuple[Source, Series]]) -> Diagnosis:
    """The diagnosis with an unnamed law for what is left, if one predicts; the verdict stays.

    A law of the given model stays too. One whose own simulation is no better is not written.

    Parameters
    ----------
    diagnosis
        With its effects.
    places
        The recordings asked about, the last of its series.
    """
    findings, model = diagnosis.findings, diagnosis.model
    if model.unnamed_law is not None:
        return diagnosis
    modelled = (
        diagnosis.base if findings.after == findings.before else diagnosis.extended
    )  # of the model that is written
    files = slice(
        len(diagnosis.series) - len(findings.recordings), None
    )  # not what stands for recordings that are gone
    fitted = fit_unnamed(diagnosis.series[files], modelled[files], findings.floor)
    if fitted is None:
        return diagnosis
    with_law = model.model_copy(update={"unnamed_law": fitted.law})
    runs = [free_run(with_law, *one) for one in places]
    after = tared_rms(runs)
    if after >= BETTER * findings.after:
        return diagnosis
    extended = [
        readings + LawStep(fitted.law, one.dt_s).run(one.command_V, readings)
        for one, readings in zip(diagnosis.series, modelled, strict=True)
    ]
    first = len(extended) - len(runs)
    extended[first:] = [run.over(one) for run, one in zip(runs, diagnosis.series[first:], strict=True)]
    residuals = [one.reading_N - readings for one, readings in zip(diagnosis.series, extended, strict=True)]
    judging = [one.as_judged() for one in diagnosis.series]
    left = explainable(judging, residuals, extended)
    moving = motion(judging, residuals, extended)
    drivers = tuple(axis.driver for axis in fitted.law.drivers)
    short = fitted.formula
    said = "" if short is None else short.text(model.input.unit, model.output.unit, gain=fitted.law.gain)
    law = Unnamed(
        drivers, fitted.memories_s, fitted.already, fitted.before, fitted.after, fitted.p, fitted.law.gain, said
    )
    findings = replace(
        findings,
        law=law,
        after=after,
        floor=min(findings.floor, after),
        refitted=None,
        explainable=share_left(left, moving),
        nrmse_after=asked_nrmse_percent(diagnosis.series, extended),
    )
    findings = replace(findings, words=words_of(findings, Wording(model.input.unit, model.output.unit)))
    written = with_error(with_law, after)
    return replace(diagnosis, findings=findings, model=written, extended=extended, without_law=diagnosis)


def rising(result: Search) -> Search:
    """The same with plays that do not fold, where that costs little of what was gained.

    Where it costs much, what was found fits by them alone: the best in an effect's place that gains without.
    """
    found = result.found
    gained = result.base.loss - found.loss
    straight = unfolded(result.chain, found)
    if straight.loss <= found.loss + COSTS * max(gained, found.loss):
        return replace(result, found=straight)
    able = [
        (name, one)
        for name in found.effects
        for one in (unfolded(result.chain, rival) for rival in instead(result, name))
        if rises(result.chain, one) and result.base.loss - one.loss >= STILL_GAINS * gained
    ]
    if not able:
        return result
    name, best = min(able, key=lambda one: weighed(one[1]))
    taken, without_it = best.effects[-1], fitted_without(result.chain, found, name).loss
    losses = [counted(called, without_it, one.loss) for called, one in ((taken, best), (name, found))]
    beside = Beside(without_it, losses[0], {name: losses[1]})
    return replace(result, found=best, beside={**result.beside, taken: beside})


def _without(result: Search, names: Sequence[str]) -> Search:
    """The same search with some effects left out of what it found."""
    found = result.found
    for name in names:
        if name in result.given:
            found = as_given(result.chain, found, result.base, name)
            result.statuses[name] = "kept"
            continue
        terms, values = without(found, name)
        found = replace(found, terms=tuple(terms), point=replace(found.point, values=tuple(values)))
    back = [tone for tone in result.tones if tone.name in names]
    chain = result.chain.like(with_tones(result.chain.series, back))
    kept = [tone for tone in result.tones if tone.name not in names]
    base = fit(chain, result.base.terms, result.base.point) if back else result.base
    return replace(result, chain=chain, tones=kept, base=base, found=fit(chain, found.terms, found.point))
