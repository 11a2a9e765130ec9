"""From the result of a search to a diagnosis: findings with confidences, and the written model."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.adequacy.guard import explainable
from piezod.diagnose.adequacy.remainder import motion_of
from piezod.diagnose.candidates.starts import DIRECT
from piezod.diagnose.experiment.isolability import untestable
from piezod.diagnose.findings import Base, Finding, Findings, Verdict, above_noise, gap_closed
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.stack_change import factors
from piezod.diagnose.hypothesis.terms import Point, Setting, Term
from piezod.diagnose.localisation.locate import locate
from piezod.diagnose.prepare import chain_of
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.given_effects import given_effects, with_likelier_scope
from piezod.diagnose.selection.replay import Attempt, fitted_in
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.significance import with_discovery_rates
from piezod.diagnose.verdict.direct_findings import direct_findings
from piezod.diagnose.verdict.evidence import base_of, finding_of, gone_finding, unchanged_effects
from piezod.diagnose.verdict.extended import (
    extended_model,
    hysteresis_of,
    scaled_hysteresis,
    with_error,
    with_joint_estimates,
)
from piezod.diagnose.verdict.information import information_of
from piezod.diagnose.verdict.own_sizes import own_base, own_sizes
from piezod.diagnose.verdict.simulated import FreeRun, GivenRuns, free_run, tared_rms
from piezod.diagnose.verdict.tone_findings import gone_tones, is_unchanged_tone, tone_finding, with_tone_terms
from piezod.diagnose.verdict.verdict import (
    held_out_rms,
    noise_floor,
    shares_explained,
    structured_share,
    verdict_of,
    widest_range,
    with_lower_confidence,
    words_of,
)
from piezod.diagnose.verdict.words import Wording
from piezod.effects import EFFECTS
from piezod.errors import ModelError
from piezod.estimation.recordings.layout import entry_of
from piezod.estimation.recordings.series import Series
from piezod.estimation.recordings.sources import Source
from piezod.identify.scores import nrmse_percent
from piezod.model import Model
from piezod.model.parameters import Hysteresis

UNTESTABLE = 0.8  # untestable share of the catalogue above which no verdict `matches` is given
OTHER_STACK = 3.0  # error over that at the identification above which the stack itself has changed
NO_MODEL = 0.6  # factor on confidences if the fitted plays have no inverse: such plays belong to no stack


@dataclass(frozen=True)
class Diagnosis:
    """Findings with their basis.

    Parameters
    ----------
    model
        Written model: the given model with the effects found, or the given model itself.
    base, extended
        Simulated readings of every recording with the given and with the extended model, shape (N,) each.
    without_law
        Diagnosis without the unnamed law; None if there is no law.
    """

    findings: Findings
    model: Model
    series: list[Series]
    base: list[Array]
    extended: list[Array]
    attempts: Sequence[Attempt] = ()
    without_law: "Diagnosis | None" = None

    def fitted(self) -> dict[str, Setting]:
        """Parameters and choices of every effect found, and of each rival in the place of its effect."""
        places = [(finding.name, "") for finding in self.findings.effects]
        places += [(rival.name, finding.name) for finding in self.findings.effects for rival in finding.rivals]
        return fitted_in([attempt.after for attempt in self.attempts], places)


@dataclass(frozen=True)
class _WrittenModel:
    """Model that a diagnosis writes."""

    model: Model
    rms: float  # error of its simulation over the diagnosed recordings [output unit]
    runs: Sequence[FreeRun] = ()  # its free runs over these recordings; empty for the given model
    obstacle: str = ""  # reason why the extended model cannot be written; empty if there is none


@dataclass(frozen=True)
class _Remainder:
    """Residuals of the final hypothesis (one array a recording), shares explained, and noise floor [output unit]."""

    residuals: list[Array]
    share: float
    closed: float
    floor: float
    floor_from: str


@dataclass(frozen=True)
class DiagnosisInputs:
    """Inputs of a diagnosis."""

    model: Model
    sources: Sequence[Source]  # recordings as read, identification recordings first
    series: list[Series]  # prepared recordings, preceded by a substitute if the identification recordings are missing
    given_runs: GivenRuns  # free runs of the given model over the recordings
    frozen: dict[int, list[tuple[int, int]]]  # first sample and end of each frozen stretch, by the number of the series
    notes: Sequence[str]
    substitutes: int

    @property
    def hashes(self) -> list[str]:
        """SHA-256 of the recording of each series; empty for a substitute."""
        return [""] * self.substitutes + [source.sha256 for source in self.sources]

    @property
    def given_readings(self) -> list[Array]:
        """Readings that the given model expects, for every series, shape (N,) each."""
        simulated = [series.reading_N for series in self.series[: self.substitutes]]  # by the model itself
        files = self.series[self.substitutes :]
        return simulated + [run.at_samples_of(s) for run, s in zip(self.given_runs.runs, files, strict=True)]

    @property
    def predicted(self) -> float:
        """Error of the given model's own simulation over the noise of the recordings [1]."""
        noises_N = [series.noise_N for series in self.series if series.role == "recording"]
        return tared_rms(self.given_runs.diagnosed_runs) / max(float(np.sqrt(np.mean(np.square(noises_N)))), 1e-300)

    def search_start(self) -> tuple[Chain, Point, tuple[Term, ...]]:
        """Recordings without the unnamed law, the base, and the given effects held at their values.

        A model with effects states how the command runs between samples.
        """
        law_N = [np.zeros(1)] * self.substitutes + self.given_runs.law_readings(self.series[self.substitutes :])
        series = [replace(s, reading_N=s.reading_N - law) for s, law in zip(self.series, law_N, strict=True)]
        terms, values = given_effects(self.model, self.hashes)
        if terms:
            series = [replace(s, hold=self.model.hold) for s in series]
        chain, start = chain_of(series, self.model)
        start = replace(start, values=values)
        if not self.substitutes:
            terms = with_likelier_scope(coarse(chain), start, terms, self.model)
        return chain, start, terms

    def diagnosis_of(self, result: Search) -> Diagnosis:
        """Diagnosis from the result of a search."""
        chain, given = result.chain, self.given_readings
        remainder = self._remainder(result)
        series = [replace(s, reading_N=known.reading_N) for s, known in zip(chain.series, self.series, strict=True)]
        span, before = widest_range(series), tared_rms(self.given_runs.diagnosed_runs)
        effects, tones = self._effects(result)
        effects += direct_findings(chain.series, self.frozen, remainder.residuals, before)
        base = base_of(result)
        written = self._written_model(result, effects, remainder.floor, span)
        unchanged = unchanged_effects(result, self.model, written.model, effects, tones)
        after, runs = written.rms, written.runs
        if self.given_runs.law_holds and runs and not result.differs and self._is_other_stack(chain, remainder.floor):
            base = replace(base, changed=True)
        rms = held_out_rms(chain, result.hypothesis)
        least = max(after, rms) if runs else before
        untested = untestable(chain, result.hypothesis.terms, result.hypothesis.point)
        verdict, effects = self._verdict(effects, base, remainder, (before, after, least), span, untested)
        chain.forget()  # localisation needs memory too
        own = own_sizes(coarse(self._as_known(chain)), result.hypothesis, result.given)
        base = replace(base, measured=own_base(self.model, own))
        unchanged = [one.with_measured(own.get(one.name), EFFECTS[one.name].size.name) for one in unchanged]
        simulated = [s.reading_N - residual for s, residual in zip(chain.series, remainder.residuals, strict=True)]
        for k, run in enumerate(runs, start=len(series) - len(runs)):
            simulated[k] = run.at_samples_of(series[k])
        findings = Findings(
            verdict=verdict,
            words="",
            unit=self.model.output.unit,
            floor=min(remainder.floor, least),
            floor_from=remainder.floor_from,
            where=tuple(locate([s.as_judged() for s in series], residuals_of(series, given), given)),
            effects=tuple(effects),
            kept=tuple(unchanged),
            base=base,
            before=before,
            after=after,
            refitted=None if result.differs else after if runs else min(rms, before),
            span=span,
            nrmse_before=diagnosed_nrmse_percent(series, given),
            nrmse_after=diagnosed_nrmse_percent(series, simulated if runs else given),
            explainable=remainder.share,
            not_testable=untested,
            notes=tuple(self.notes),
            recordings=self._recordings(),
            ended_early=result.ended_early,
        )
        if written.obstacle:
            findings = _without_model(findings, written.obstacle)
        findings = with_words(findings, self.model)
        return Diagnosis(findings, written.model, series, given, simulated, result.attempts)

    def _remainder(self, result: Search) -> _Remainder:
        """Residuals of the final hypothesis, with the share that could still be explained."""
        chain, fitted = result.chain, result.hypothesis
        modelled = Normal.at(chain, fitted.terms, fitted.point).readings()
        residuals = residuals_of(chain.series, modelled)
        compared = [s.as_judged() for s in chain.series]
        guard = explainable(compared, residuals, modelled)
        share, closed = shares_explained(result, guard, motion_of(compared, residuals, modelled))
        return _Remainder(residuals, share, closed, *noise_floor(chain.series, residuals, guard, self.substitutes))

    def _verdict(
        self,
        effects: Sequence[Finding],
        base: Base,
        remainder: _Remainder,
        errors: tuple[float, float, float],
        span: float,
        untested: Sequence[str],
    ) -> tuple[Verdict, list[Finding]]:
        """Verdict, and the effects with confidences reduced by the structured residual.

        `errors`: error of the given model, of the written model, and on left-out blocks if that is larger.
        """
        before, after, least = errors
        above = above_noise(least, remainder.floor, span)
        closed = remainder.closed
        if above:
            closed = min(closed, max(gap_closed(before, after, remainder.floor), 0.0))
        structured = structured_share(remainder.share, least, remainder.floor, above=above)
        reduced = [with_lower_confidence(finding, structured, 1.0) for finding in effects]
        differences: list[Finding | Base] = [*reduced, *([base] if base.changed else [])]
        predicted = bool(self.model.effects) and not above_noise(before, remainder.floor, span)
        verdict = verdict_of(remainder.share, closed, differences, above=above, predicted=predicted)
        if verdict == "matches" and len(untested) > UNTESTABLE * (len(EFFECTS) - len(DIRECT)):
            verdict = "not_testable"
        if verdict == "partly_explained":
            reduced = [with_lower_confidence(finding, structured, closed) for finding in effects]
        return verdict, reduced

    def _recordings(self) -> tuple[dict[str, Any], ...]:
        """Path, hash, number of samples and left-out stretches of each recording."""
        return tuple(
            {
                "path": source.recording.source,
                "sha256": source.sha256,
                "samples": int(source.recording.time_s.size),
                "left_out_s": [list(stretch) for stretch in run.left_out_s],
            }
            for source, run in zip(self.sources, self.given_runs.runs, strict=True)
        )

    def _effects(self, result: Search) -> tuple[list[Finding], list[str]]:
        """New, changed and gone effects, and the names of unchanged tones of the given model."""
        statuses = result.statuses
        named = [name for name in result.hypothesis.effects if name in result.new or statuses.get(name) == "changed"]
        gone = [name for name, status in statuses.items() if status == "gone"]
        effects = with_discovery_rates(each(lambda name: finding_of(result, name, self.model), named))
        effects += [gone_finding(result, name, self.model) for name in gone]
        names = dict.fromkeys(tone.name for tone in result.diagnosed_tones)
        tones = [tone_finding(result, name, self.model) for name in names]
        effects += [tone for tone in tones if not is_unchanged_tone(tone)]
        effects += gone_tones(result, self.model)
        return effects, [tone.name for tone in tones if is_unchanged_tone(tone)]

    def _is_other_stack(self, chain: Chain, floor: float) -> bool:
        """Whether the given model errs much more than at its identification, with the hold of these recordings."""
        hold = chain.series[-1].hold
        resampled = self.model.model_copy(update={"sampling": hold.sampling, "read_after": hold.read_after})
        error = tared_rms([free_run(resampled, *pair) for pair in self.given_runs.diagnosed])
        return error > OTHER_STACK * max(floor, self.model.provenance.fit.rms_held_out or 0.0)

    def _written_model(self, result: Search, effects: Sequence[Finding], floor: float, span: float) -> _WrittenModel:
        """Extended model, or the given model if nothing differs and its error is noise.

        Without a difference, a model with refitted hysteresis is written only if its error is noise.
        """
        before = tared_rms(self.given_runs.diagnosed_runs)
        gone = {finding.name for finding in effects if finding.status == "gone" and EFFECTS[finding.name].is_tone}
        model = self._without(gone)
        given = _WrittenModel(model, before)
        if not (result.differs or result.refined) and not above_noise(before, floor, span):
            return given
        model = with_joint_estimates(model, result.refined)
        parent = model if self.given_runs.law_holds else model.model_copy(update={"unnamed_law": None})
        intervals = {finding.name: finding.parameters for finding in effects}
        fitted = with_tone_terms(result.hypothesis, result.diagnosed_tones)
        written = given
        for keeps_base in (True, False) if self._may_keep_base(result) else (False,):
            try:
                hysteresis = self._scaled_base(result) if keeps_base else hysteresis_of(result.chain, result.hypothesis)
                extended = extended_model(parent, result.chain, fitted, hysteresis, self.hashes, intervals)
            except ModelError as error:
                return replace(given, obstacle=str(error)) if result.differs else given
            if result.stack_changed:
                extended = self._with_new_base(extended)
            runs = [free_run(extended, *pair) for pair in self.given_runs.diagnosed]
            written = _WrittenModel(extended, tared_rms(runs), runs)
            if not above_noise(written.rms, floor, span):
                break
        if not result.differs and (written.rms >= RULES.better * before or above_noise(written.rms, floor, span)):
            return given
        information = information_of(self._as_known(result.chain), result.hypothesis, written.model, self.hashes)
        extended = with_error(written.model.model_copy(update={"information": information}), written.rms)
        return replace(written, model=extended)

    def _may_keep_base(self, result: Search) -> bool:
        """Whether the base of a model with effects stays if the error is noise then.

        Without the recordings of its identification, a base follows each new recording, and takes a part of the change
        of an effect.
        """
        return result.has_known and self.substitutes > 0

    def _scaled_base(self, result: Search) -> Hysteresis:
        """Hysteresis of the given model with the change of the stack."""
        return scaled_hysteresis(self.model.hysteresis, factors(result.hypothesis.terms, result.hypothesis.point))

    def _as_known(self, chain: Chain) -> Chain:
        """Chain without the looser base of the search."""
        weighted = [replace(s, noise_N=known.noise_N) for s, known in zip(chain.series, self.series, strict=True)]
        return chain.like(weighted)

    def _without(self, tones: Collection[str]) -> Model:
        """Given model without some tones; the given model itself without any."""
        if not tones:
            return self.model
        effects = tuple(effect for effect in self.model.effects if effect.name not in tones)
        return self.model.model_copy(update={"effects": effects})

    def _with_new_base(self, extended: Model) -> Model:
        """Model of a changed stack: only the diagnosed recordings belong to its base."""
        diagnosed = [source for source in self.sources if source.role == "recording"]
        recordings = tuple(entry_of(source.recording, source.sha256, source.text) for source in diagnosed)
        effects = tuple(
            effect if effect.recording else effect.model_copy(update={"since": "identification"})
            for effect in extended.effects
        )
        provenance = extended.provenance.model_copy(update={"recordings": recordings})
        return extended.model_copy(update={"effects": effects, "provenance": provenance})


def _without_model(findings: Findings, obstacle: str) -> Findings:
    """Findings with lower confidences, since the fitted plays have no inverse."""
    return replace(
        findings,
        verdict="partly_explained" if findings.effects else "unexplained",
        effects=tuple(replace(finding, confidence=NO_MODEL * finding.confidence) for finding in findings.effects),
        notes=(*findings.notes, f"no extended model, model.yaml holds the given one: {obstacle}"),
    )


def residuals_of(series: Sequence[Series], readings: Sequence[Array]) -> list[Array]:
    """Measured readings minus simulated ones of every recording, shape (N,) each."""
    return [s.reading_N - simulated for s, simulated in zip(series, readings, strict=True)]


def with_words(findings: Findings, model: Model) -> Findings:
    """Findings with their summary in the units of the model."""
    return replace(findings, words=words_of(findings, Wording(model.input.unit, model.output.unit)))


def diagnosed_nrmse_percent(series: Sequence[Series], simulated: Sequence[Array]) -> float:
    """Fit over the diagnosed recordings as MATLAB's `compare` defines it [%]."""
    pairs = [(s, readings) for s, readings in zip(series, simulated, strict=True) if s.role == "recording"]
    measured = np.concatenate([s.reading_N[s.counts] for s, _ in pairs])
    return nrmse_percent(measured, np.concatenate([readings[s.counts] for s, readings in pairs]))
