"""Diagnosis of recordings: prepare them, search for effects, assess the result, and describe the remainder."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from piezod.arrays import Array
from piezod.diagnose.adequacy.guard import explainable
from piezod.diagnose.adequacy.remainder import motion_of
from piezod.diagnose.adequacy.unrecorded import CERTAIN, unrecorded_input
from piezod.diagnose.candidates.tones import with_tones
from piezod.diagnose.findings import UNKNOWN, Unnamed, Verdict
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.monotone import is_monotone, monotone_fit
from piezod.diagnose.judgement import Diagnosis, DiagnosisInputs, diagnosed_nrmse_percent, residuals_of, with_words
from piezod.diagnose.lineage import with_lineage
from piezod.diagnose.prepare import substitute_recording
from piezod.diagnose.ranges import compare_ranges
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import comparison_loss, penalised_loss
from piezod.diagnose.selection.finish import with_each_rival
from piezod.diagnose.selection.given_effects import as_given, refitted_without, tone_frequencies_Hz, without
from piezod.diagnose.selection.search import OnProgress, search
from piezod.diagnose.selection.search_state import Rivalry, Search
from piezod.diagnose.selection.stated_hold import with_stated_hold
from piezod.diagnose.selection.unnamed import FittedLaw, fit_unnamed
from piezod.diagnose.selection.unnamed_dynamics import fit_unnamed_dynamics
from piezod.diagnose.verdict.direct_findings import confirmed_frozen
from piezod.diagnose.verdict.extended import with_error
from piezod.diagnose.verdict.low_confidence import (
    effects_without_gain,
    highest_confidences,
    is_required,
    least_confident,
    rejection_notes,
    undetermined_effect,
    undetermined_notes,
)
from piezod.diagnose.verdict.simulated import FreeRun, GivenRuns, free_run, tared_rms
from piezod.diagnose.verdict.verdict import RECORD_NOISE, explainable_share
from piezod.diagnose.verdict.words import Wording
from piezod.estimation.recordings.converter import unrounded
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.series import Series
from piezod.estimation.recordings.sources import Source
from piezod.model import Model, model_sha256
from piezod.model.unnamed_law import LawStep

WITHOUT_NOISE: dict[Verdict, Verdict] = {"matches": "not_testable", "explained": "partly_explained"}
"""Verdict if the noise is unknown: then nothing shows that the residual is noise."""
MISSED: dict[Verdict, Verdict] = {"matches": "unexplained", "explained": "partly_explained"}
"""Verdict if an unrecorded input was taken for noise."""
WITHOUT_INFORMATION = (
    "the model file states no information on its parameters, as in files of older versions, and no recording of its "
    "identification is there; the model's own simulation replaces them"
)
SEARCHED = 0.65  # share of a limited time after which the search ends; the checks need the rest
COSTS = 0.1  # largest cost of a monotone loading curve, as a share of the gain or of the loss
STILL_GAINS = 0.5  # least gain of a rival with a monotone curve, as a share of the gain without


def diagnose(
    model: Model,
    recordings: Sequence[Source],
    past: Sequence[Source],
    notes: Sequence[str],
    progress: OnProgress,
    within_s: float | None = None,
    parent: str | None = None,
) -> Diagnosis:
    """Find what the model leaves out of the recordings.

    Parameters
    ----------
    past
        Identification recordings; empty: a recording simulated from the model replaces them.
    progress
        Called with the current step, and the share of the work that is done; None where it is unknown.
    within_s
        Time for the diagnosis [s]; about a third of it is for the checks after the search. None: no limit.
    parent
        SHA-256 of the file of the model; None: of the file that would be written.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    with threadpool_limits(1, user_api="blas"):  # fits run in parallel; more BLAS threads would compete for the cores
        until_s = np.inf if within_s is None else time.monotonic() + SEARCHED * within_s
        diagnosis = _diagnosed(model, recordings, past, notes, progress, until_s)
    return with_lineage(diagnosis, model, parent or model_sha256(model), recordings)


def _diagnosed(
    model: Model,
    recordings: Sequence[Source],
    past: Sequence[Source],
    notes: Sequence[str],
    progress: OnProgress,
    until_s: float,
) -> Diagnosis:
    progress("reading", None)
    inputs = _inputs(model, recordings, past, notes)
    chain, start, given = inputs.search_start()
    result = search(
        chain, start, progress, given, until_s, model.information, tone_frequencies_Hz(model), inputs.predicted
    )
    if result.ended_early:
        inputs = replace(inputs, notes=[*inputs.notes, _ended_early(result)])
    result.chain.forget()
    chain, hypothesis = with_stated_hold(result.chain, result.hypothesis)
    result = replace(result, chain=chain, hypothesis=hypothesis)
    result = with_monotone_curve(result)
    progress("checking the residual", None)
    diagnosis = inputs.diagnosis_of(result)
    residuals = residuals_of(diagnosis.series, diagnosis.extended)
    # frozen stretches are confirmed once, with all effects: a stretch that the full model explains is not frozen
    inputs = replace(inputs, frozen=confirmed_frozen(diagnosis.series, inputs.frozen, residuals))
    diagnosis = _without_weak_effects(inputs, result, diagnosis, progress)
    if diagnosis.findings.verdict in ("unexplained", "partly_explained") and not result.ended_early:
        progress("looking for a law without a name", None)
        diagnosis = with_unrecorded_input(with_unnamed_law(diagnosis, inputs.given_runs.diagnosed))
    if not diagnosis.findings.noise_is_known:
        return _with_unknown_noise(diagnosis)
    return with_unrecorded_gain(diagnosis)


def _ended_early(result: Search) -> str:
    """Note on a search whose time was over."""
    found = ", ".join(result.new) or "none"
    return (
        f"the time was over before the search ended (--within); effects found by then: {found}; further effects and "
        "their rivals were not compared, and no unnamed law was fitted; give more time, or a shorter recording"
    )


def _inputs(
    model: Model, recordings: Sequence[Source], past: Sequence[Source], notes: Sequence[str]
) -> DiagnosisInputs:
    """Prepared recordings with the free runs of the given model."""
    sources = [*past, *recordings]
    series = [unrounded(recording) for recording in prepared(sources, model)]
    all_notes = [*notes, *compare_ranges(model, series), *(note for recording in series for note in recording.notes)]
    given_runs = GivenRuns.of(model, sources, series)
    if not past:
        series.insert(0, substitute_recording(model))
        if model.information is None:
            all_notes.append(WITHOUT_INFORMATION)
    if not given_runs.law_holds:
        all_notes.append("the unnamed law of the given model makes the recordings worse, and is left out")
    frozen = {number: list(recording.frozen) for number, recording in enumerate(series) if recording.frozen}
    return DiagnosisInputs(model, sources, series, given_runs, frozen, all_notes, substitutes=int(not past))


def _without_weak_effects(
    inputs: DiagnosisInputs, result: Search, diagnosis: Diagnosis, progress: OnProgress
) -> Diagnosis:
    """Diagnosis after removal of effects without gain, of undetermined size, or of low confidence, in this order.

    An effect of low confidence stays if the recordings are explained with it and not without it.
    """
    model = inputs.model
    wording = Wording(model.input.unit, model.output.unit)
    highest = highest_confidences(diagnosis.findings)
    while True:
        findings = diagnosis.findings
        without_gain = effects_without_gain(result, findings, delivered=diagnosis.model is not model)
        undetermined = [] if without_gain else undetermined_effect(findings)
        removed = without_gain or undetermined or least_confident(result, findings, highest)
        if not removed:
            return diagnosis
        progress("leaving out what is doubtful", None)
        notes = undetermined_notes(findings, undetermined, wording) or rejection_notes(findings, removed)
        inputs = replace(inputs, notes=[*inputs.notes, *notes])
        result = with_monotone_curve(_without_effects(result, removed))
        reduced = inputs.diagnosis_of(result)
        if not (without_gain or undetermined) and is_required(findings, reduced.findings):
            return diagnosis
        diagnosis, highest = reduced, highest_confidences(reduced.findings, highest)


def _with_unknown_noise(diagnosis: Diagnosis) -> Diagnosis:
    """Diagnosis with a verdict that does not need the noise."""
    findings = diagnosis.findings
    verdict = WITHOUT_NOISE.get(findings.verdict, findings.verdict)
    findings = replace(findings, verdict=verdict, notes=(*findings.notes, RECORD_NOISE))
    return replace(diagnosis, findings=with_words(findings, diagnosis.model))


def with_unrecorded_input(diagnosis: Diagnosis) -> Diagnosis:
    """Diagnosis with an unrecorded input if the residual indicates one and there is no unnamed law."""
    findings = diagnosis.findings
    if findings.law is not None:
        return diagnosis
    residuals = residuals_of(diagnosis.series, diagnosis.extended)
    compared = [s.as_judged() for s in diagnosis.series]
    unrecorded = unrecorded_input(compared, residuals, diagnosis.extended, findings.explainable)
    findings = with_words(replace(findings, unrecorded=unrecorded), diagnosis.model)
    return replace(diagnosis, findings=findings)


def with_unrecorded_gain(diagnosis: Diagnosis) -> Diagnosis:
    """Diagnosis of an unrecorded input that acts as a gain, where the model seems to match.

    Such an input differs between repeats of the command, which takes it for noise. But it keeps its value for many
    samples and grows with the force, as no noise of a sensor does.
    """
    findings = diagnosis.findings
    if findings.verdict not in MISSED:
        return diagnosis
    residuals, compared = residuals_of(diagnosis.series, diagnosis.extended), [s.as_judged() for s in diagnosis.series]
    unrecorded = unrecorded_input(compared, residuals, diagnosis.extended, findings.explainable, CERTAIN)
    if unrecorded is None or not unrecorded.gain:
        return diagnosis
    verdict, floor = MISSED[findings.verdict], min(unrecorded.fast, findings.floor)
    findings = replace(findings, verdict=verdict, unrecorded=unrecorded, floor=floor, floor_from=UNKNOWN)
    return replace(diagnosis, findings=with_words(findings, diagnosis.model))


def with_unnamed_law(diagnosis: Diagnosis, diagnosed: Sequence[tuple[Source, Series]]) -> Diagnosis:
    """Diagnosis with an unnamed law for the residual, if one predicts it; the verdict stays.

    A law of the given model stays too. A law that does not lower the error of the simulation is not written.

    `diagnosed`: diagnosed recordings with their series, the last of the diagnosis.
    """
    findings, model = diagnosis.findings, diagnosis.model
    if model.unnamed_law is not None:
        return diagnosis
    modelled = diagnosis.base if findings.after == findings.before else diagnosis.extended  # of the written model
    files = slice(len(diagnosis.series) - len(findings.recordings), None)  # without the substitute recording
    best: tuple[float, FittedLaw, Model, list[FreeRun]] | None = None
    for fit_law in (fit_unnamed, fit_unnamed_dynamics):
        if (tried := fit_law(diagnosis.series[files], modelled[files], findings.floor)) is None:
            continue
        since = "identification" if tried.already else "later"
        with_law = model.model_copy(update={"unnamed_law": tried.law.model_copy(update={"since": since})})
        runs = [free_run(with_law, *pair) for pair in diagnosed]
        after = tared_rms(runs)
        if after < RULES.better * (findings.after if best is None else best[0]):
            best = after, tried, with_law, runs
    if best is None:
        return diagnosis
    after, fitted, with_law, runs = best
    extended = _readings_with_law(diagnosis.series, modelled, fitted, runs)
    residuals = residuals_of(diagnosis.series, extended)
    compared = [s.as_judged() for s in diagnosis.series]
    guard, motion = explainable(compared, residuals, extended), motion_of(compared, residuals, extended)
    findings = replace(
        findings,
        law=_law_finding(fitted, model),
        after=after,
        floor=min(findings.floor, after),
        refitted=None,
        explainable=explainable_share(guard, motion),
        nrmse_after=diagnosed_nrmse_percent(diagnosis.series, extended),
    )
    written = with_error(with_law, after)
    return replace(
        diagnosis, findings=with_words(findings, model), model=written, extended=extended, without_law=diagnosis
    )


def _readings_with_law(
    series: Sequence[Series], modelled: Sequence[Array], fitted: FittedLaw, runs: Sequence[FreeRun]
) -> list[Array]:
    """Simulated readings with the law; those of the diagnosed recordings, the last, from their free runs."""
    others = len(series) - len(runs)
    readings = [
        known + LawStep(fitted.law, s.dt_s).run(s.command_V, known)
        for s, known in zip(series[:others], modelled[:others], strict=True)
    ]
    return readings + [run.at_samples_of(s) for run, s in zip(runs, series[others:], strict=True)]


def _law_finding(fitted: FittedLaw, model: Model) -> Unnamed:
    law, formula = fitted.law, fitted.formula
    return Unnamed(
        tuple(axis.driver for axis in law.drivers),
        fitted.memories_s,
        fitted.already,
        fitted.before,
        fitted.after,
        fitted.p,
        law.gain,
        "" if formula is None else formula.text(model.input.unit, model.output.unit, gain=law.gain),
        tuple((mode.frequency_Hz, mode.damping_ratio) for mode in law.modes),
        law.linear,
    )


def with_monotone_curve(result: Search) -> Search:
    """Result refitted with a monotone loading curve.

    If the loss rises by more than `COSTS`, an effect is replaced by the rival that fits best with a monotone curve.
    Without such a rival the result stays.
    """
    fitted = result.hypothesis
    gain = result.base.loss - fitted.loss
    monotone = monotone_fit(result.chain, fitted)
    if monotone.loss <= fitted.loss + COSTS * max(gain, fitted.loss):
        return replace(result, hypothesis=monotone)
    alternatives = [
        (name, rival)
        for name in fitted.effects
        for rival in (monotone_fit(result.chain, rival) for rival in with_each_rival(result, name))
        if is_monotone(result.chain, rival) and result.base.loss - rival.loss >= STILL_GAINS * gain
    ]
    if not alternatives:
        return result
    name, best = min(alternatives, key=lambda alternative: penalised_loss(alternative[1]))
    new, reduced_loss = best.effects[-1], refitted_without(result.chain, fitted, name).loss
    losses = [comparison_loss(effect, reduced_loss, h.loss) for effect, h in ((new, best), (name, fitted))]
    rivalry = Rivalry(reduced_loss, losses[0], {name: losses[1]})
    return replace(result, hypothesis=best, rivalries={**result.rivalries, new: rivalry})


def _without_effects(result: Search, names: Sequence[str]) -> Search:
    """Result without some effects: new ones are removed, those of the given model get their old values."""
    fitted, statuses = result.hypothesis, dict(result.statuses)
    for name in names:
        if name in result.given:
            fitted = as_given(result.chain, fitted, result.base, name)
            statuses[name] = "kept"
            continue
        terms, values = without(fitted, name)
        fitted = replace(fitted, terms=tuple(terms), point=replace(fitted.point, values=tuple(values)))
    removed = [tone for tone in result.tones if tone.name in names]
    chain = result.chain.like(with_tones(result.chain.series, removed))
    tones = tuple(tone for tone in result.tones if tone.name not in names)
    base = fit(chain, result.base.terms, result.base.point) if removed else result.base
    fitted = fit(chain, fitted.terms, fitted.point)
    return replace(result, chain=chain, tones=tones, base=base, hypothesis=fitted, statuses=statuses)
