"""Judgement of what a search found: findings with their confidence, and the model that is written."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.adequacy.guard import explainable
from piezod.diagnose.adequacy.remainder import motion
from piezod.diagnose.candidates.screening import DIRECT
from piezod.diagnose.experiment.testable import untestable
from piezod.diagnose.findings import Finding, Findings, Place, above_noise, gap_closed
from piezod.diagnose.hypothesis.chain import Chain, Point, Setting, Term
from piezod.diagnose.hypothesis.fit import Normal
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.localisation.locate import locate
from piezod.diagnose.prepare import Source, chain_of
from piezod.diagnose.selection.acceptance import BETTER
from piezod.diagnose.selection.given_effects import given_effects, with_likelier_scope
from piezod.diagnose.selection.replay import Attempt, fitted_in
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.significance import with_shares
from piezod.diagnose.verdict.evidence import (
    all_terms,
    base_of,
    finding_of,
    gone_finding,
    kept_effects,
    read_off,
    same_tone,
    tone_finding,
)
from piezod.diagnose.verdict.extended import extended_model, with_error
from piezod.diagnose.verdict.simulated import FreeRun, GivenRuns, free_run, tared_rms
from piezod.diagnose.verdict.verdict import (
    held_out_rms,
    less_sure,
    no_noise,
    noise_floor,
    remaining,
    span_of,
    verdict_of,
    words_of,
)
from piezod.diagnose.verdict.words import Wording
from piezod.effects import EFFECTS
from piezod.errors import ModelError
from piezod.identify.layout import entry_of
from piezod.identify.scores import nrmse_percent
from piezod.model import Model

Array = NDArray[np.float64]

MOSTLY = 0.8  # of the catalogue: recordings that could not have shown so much of it tell nothing
UNLIKE_ITSELF = 3.0  # times the error that a model had when it was identified: so much larger, the stack is another
FOLDED = 0.6  # of its confidence that an effect keeps when the plays fold that were refitted with it


@dataclass(frozen=True)
class Diagnosis:
    """Findings and what they rest on.

    Parameters
    ----------
    findings
        The verdict.
    model
        The given model with what was found; the given one where nothing was.
    series
        All recordings, made ready.
    base, extended
        Simulated readings of every recording, the given model's and the extended one's.
    attempts
        Hypotheses that were compared.
    without_law
        The same without its unnamed law; None where there is none.
    """

    findings: Findings
    model: Model
    series: list[Series]
    base: list[Array]
    extended: list[Array]
    attempts: Sequence[Attempt] = ()
    without_law: "Diagnosis | None" = None

    def fitted(self) -> dict[str, Setting]:
        """Parameters and choices of every effect found, and of each rival where it takes the effect's place."""
        places = [(one.name, "") for one in self.findings.effects]
        places += [(rival.name, one.name) for one in self.findings.effects for rival in one.rivals]
        return fitted_in([attempt.after for attempt in self.attempts], places)


@dataclass(frozen=True)
class _Written:
    """The model that a diagnosis writes.

    Parameters
    ----------
    model
        The model.
    rms
        Error that its simulation leaves on the recordings asked about [output unit].
    runs
        It in free run over them; empty where it is the given model.
    why_not
        Why no other model can be written; empty where none needs to be.
    """

    model: Model
    rms: float
    runs: Sequence[FreeRun] = ()
    why_not: str = ""


@dataclass(frozen=True)
class Judgement:
    """What every judgement of one diagnosis starts from.

    Parameters
    ----------
    model
        As it was given.
    sources
        Those of the identification first.
    series
        The recordings made ready, one that stands for those of the identification first where these are gone.
    before
        The given model in free run over the recordings.
    frozen
        Stretches of readings that stand still, by the number of their series.
    notes
        What was noticed.
    stand_ins
        How many series stand for recordings that are gone.
    """

    model: Model
    sources: Sequence[Source]
    series: list[Series]
    before: GivenRuns
    frozen: dict[int, list[tuple[int, int]]]
    notes: list[str]
    stand_ins: int

    @property
    def hashes(self) -> list[str]:
        """SHA-256 of the recording of each series; empty where it is gone."""
        return [""] * self.stand_ins + [source.sha256 for source in self.sources]

    @property
    def given(self) -> list[Array]:
        """Readings that the given model expects, of every series."""
        own = [one.reading_N for one in self.series[: self.stand_ins]]  # simulated by the model itself
        files = self.series[self.stand_ins :]
        return own + [run.over(one) for run, one in zip(self.before.runs, files, strict=True)]

    def begun(self) -> tuple[Chain, Point, tuple[Term, ...]]:
        """Where the search begins: recordings without the given law, the base, and the given effects at their values.

        A model with effects states how the command runs between samples, and is followed in that.
        """
        law_N = [np.zeros(1)] * self.stand_ins + self.before.law(self.series[self.stand_ins :])
        series = [replace(one, reading_N=one.reading_N - law) for one, law in zip(self.series, law_N, strict=True)]
        terms, values = given_effects(self.model, self.hashes)
        if terms:
            series = [replace(one, hold=self.model.hold) for one in series]
        chain, start = chain_of(series, self.model)
        start = replace(start, values=values)
        if not self.stand_ins:
            terms = with_likelier_scope(coarse(chain), start, terms, self.model)
        return chain, start, terms

    def judged(self, result: Search) -> Diagnosis:
        """What a search found, with how sure it is and what is left."""
        chain, found, given = result.chain, result.found, self.given
        normal = Normal.at(chain, found.terms, found.point)
        modelled = normal.readings()
        residuals = [one.reading_N - simulated for one, simulated in zip(chain.series, modelled, strict=True)]
        judging = [one.as_judged() for one in chain.series]
        left = explainable(judging, residuals, modelled)
        share, closed = remaining(result, left, motion(judging, residuals, modelled))
        floor, floor_from = noise_floor(chain.series, residuals, left, self.stand_ins)
        series = [replace(one, reading_N=known.reading_N) for one, known in zip(chain.series, self.series, strict=True)]
        before = tared_rms(self.before.asked)
        effects, tones = self._effects(result)
        effects += read_off(chain.series, self.frozen, residuals, before)
        base, kept = base_of(result), kept_effects(result, self.model, effects, tones)
        span = span_of(series)
        written = self._delivered(result, effects, floor, span)
        after, runs = written.rms, written.runs
        if self.before.law_holds and runs and not result.differs and self._unlike_itself(chain, floor):
            base = replace(base, changed=True)
        refitted = None if result.differs else after if runs else min(held_out_rms(chain, found), before)
        least = max(after, held_out_rms(chain, found)) if runs else before
        above = above_noise(least, floor, span)
        if above:
            closed = min(closed, max(gap_closed(before, after, floor), 0.0))
        unlike_noise = no_noise(share, least, floor, above=above)
        sure = [less_sure(one, unlike_noise, 1.0) for one in effects]
        verdict = verdict_of(share, closed, [*sure, base] if base.changed else sure, above=above)
        blind = untestable(chain, found.terms, found.point)
        if verdict == "matches" and len(blind) > MOSTLY * (len(EFFECTS) - len(DIRECT)):
            verdict = "not_testable"
        chain.forget()  # what follows takes memory of its own
        if verdict == "partly_explained":
            sure = [less_sure(one, unlike_noise, closed) for one in effects]
        simulated = [one.reading_N - residual for one, residual in zip(chain.series, residuals, strict=True)]
        for k, run in enumerate(runs, start=len(series) - len(runs)):
            simulated[k] = run.over(series[k])
        findings = Findings(
            verdict=verdict,
            words="",
            unit=self.model.output.unit,
            floor=min(floor, least),
            floor_from=floor_from,
            where=tuple(
                Place(one.axis, one.low, one.high, one.share, one.p)
                for one in locate(
                    [one.as_judged() for one in series],
                    [one.reading_N - by for one, by in zip(series, given, strict=True)],
                    given,
                )
            ),
            effects=tuple(sure),
            kept=tuple(kept),
            base=base,
            before=before,
            after=after,
            refitted=refitted,
            span=span,
            nrmse_before=asked_nrmse_percent(series, given),
            nrmse_after=asked_nrmse_percent(series, simulated if runs else given),
            explainable=share,
            not_testable=blind,
            notes=tuple(self.notes),
            recordings=tuple(
                {
                    "path": one.recording.source,
                    "sha256": one.sha256,
                    "samples": int(one.recording.time_s.size),
                    "left_out_s": [list(stretch) for stretch in run.left_out_s],
                }
                for one, run in zip(self.sources, self.before.runs, strict=True)
            ),
        )
        if written.why_not:
            findings = _not_delivered(findings, written.why_not)
        wording = Wording(self.model.input.unit, self.model.output.unit)
        findings = replace(findings, words=words_of(findings, wording))
        return Diagnosis(findings, written.model, series, given, simulated, result.attempts)

    def _effects(self, result: Search) -> tuple[list[Finding], list[str]]:
        """What is new, has changed or is gone, and the tones of the given model that have not changed."""
        named = [name for name in result.found.effects if name in result.new or result.statuses.get(name) == "changed"]
        gone = [name for name, status in result.statuses.items() if status == "gone"]
        effects = with_shares(each(lambda name: finding_of(result, name, self.model), named))
        effects += [gone_finding(result, name, self.model) for name in gone]
        names = dict.fromkeys(tone.name for tone in result.tones_asked_about)
        tones = [tone_finding(result, name, self.model) for name in names]
        return effects + [one for one in tones if not same_tone(one)], [one.name for one in tones if same_tone(one)]

    def _unlike_itself(self, chain: Chain, floor: float) -> bool:
        """Whether the stack is another than the one that the given model was made with.

        The recordings may have been sampled otherwise, so the model is told how the command runs in them.
        """
        hold = chain.series[-1].hold
        sampled = self.model.model_copy(update={"sampling": hold.sampling, "read_after": hold.read_after})
        error = tared_rms([free_run(sampled, *one) for one in self.before.places])
        return error > UNLIKE_ITSELF * max(floor, self.model.provenance.fit.rms_held_out or 0.0)

    def _delivered(self, result: Search, effects: Sequence[Finding], floor: float, span: float) -> _Written:
        """The model that is written: the given one where nothing differs from it and it leaves only noise.

        Where it leaves more, and its hysteresis once refitted does not, that is written.
        """
        before = tared_rms(self.before.asked)
        given = _Written(self.model, before)
        if not result.differs and not above_noise(before, floor, span):
            return given
        found = all_terms(result.found, result.tones_asked_about)
        intervals = {one.name: one.parameters for one in effects}
        kept = self.model if self.before.law_holds else self.model.model_copy(update={"unnamed_law": None})
        try:
            extended = extended_model(kept, result.chain, found, self.hashes, intervals)
        except ModelError as error:
            return replace(given, why_not=str(error)) if result.differs else given
        if result.stack_changed:
            extended = self._rebased(extended)
        runs = [free_run(extended, *one) for one in self.before.places]
        after = tared_rms(runs)
        if not result.differs and (after >= BETTER * before or above_noise(after, floor, span)):
            return given
        return _Written(with_error(extended, after), after, runs)

    def _rebased(self, extended: Model) -> Model:
        """The model of a stack that has changed: older recordings are another stack's."""
        asked = [source for source in self.sources if source.role == "recording"]
        recordings = tuple(entry_of(one.recording, one.sha256, one.text) for one in asked)
        effects = tuple(
            one if one.recording else one.model_copy(update={"since": "identification"}) for one in extended.effects
        )
        provenance = extended.provenance.model_copy(update={"recordings": recordings})
        return extended.model_copy(update={"effects": effects, "provenance": provenance})


def _not_delivered(findings: Findings, why: str) -> Findings:
    """Findings without a model: plays that fold are no stack's, and whatever they needed to fit is not understood."""
    return replace(
        findings,
        verdict="partly_explained" if findings.effects else "unexplained",
        effects=tuple(replace(one, confidence=FOLDED * one.confidence) for one in findings.effects),
        notes=(*findings.notes, f"no extended model, model.yaml holds the given one: {why}"),
    )


def asked_nrmse_percent(series: Sequence[Series], simulated: Sequence[Array]) -> float:
    """Over the recordings asked about."""
    asked = [(one, by) for one, by in zip(series, simulated, strict=True) if one.role == "recording"]
    measured = np.concatenate([one.reading_N[one.counts] for one, _ in asked])
    return nrmse_percent(measured, np.concatenate([by[one.counts] for one, by in asked]))
