"""Verdict of a diagnosis: noise floor, explained share, highest_confidences, and the summary sentence."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.adequacy.guard import Guard
from piezod.diagnose.adequacy.remainder import Motion
from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.findings import UNKNOWN, Base, Finding, Findings, Verdict
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.verdict.words import (
    Wording,
    base_words,
    effect_words,
    law_words,
    unchanged_words,
    unrecorded_words,
)
from piezod.estimation.recordings.noise import noise_of, rests
from piezod.estimation.recordings.series import Series

MISSING_SHARE = 0.1  # explainable share of the residual above which something is missing
PREDICTED_SHARE = 0.25
"""MISSING_SHARE of an unchanged given model with effects. It predicts, with the errors of all its values.
Unchanged models of concealed lives left up to 0.26 in new recordings, true changes at least 0.9."""
PARTLY_SHARE = 0.75  # explainable share above which nothing is `explained`: the residual is twice the noise
LEVEL_SHARE = 0.25  # least share of the residual that grows with the force; a smaller one is ignored
SIGNIFICANT = 0.01  # largest p-value at which the explainable share counts
CLOSED = 0.97  # least explained share of the explainable error in an `explained` verdict with something missing
CONFIDENT = 0.5  # least confidence that one name needs if something is missing: more likely right than wrong
PARTLY_FACTOR = 0.9  # upper limit of a confidence if the effect leaves a structured residual
FEWEST_HOLDS = 3  # rests that determine the noise; fewer may be exceptions
HOLD_S, SHORT_HOLD_S = 0.5, 0.15  # duration of the rests; short rests hide slow noise
SLOW_NOISE = 1.5  # upper limit of the noise over that in short rests; 1.41 if half of its power is slow
RECORD_NOISE = (
    "the noise is unknown, since the command neither rests nor repeats: record three holds of half a second at "
    "different levels, or drive the same course twice"
)


def held_out_rms(chain: Chain, fitted: Fitted) -> float:
    """Rms error of left-out blocks over the diagnosed recordings [output unit]."""
    power, samples, first = 0.0, 0.0, 0
    for series in chain.series:
        blocks = slice(first, first + len(series.blocks))
        first += len(series.blocks)
        if series.role == "recording":
            power += float(fitted.losses[blocks] @ fitted.samples[blocks]) * series.noise_N**2
            samples += float(fitted.samples[blocks].sum())
    return float(np.sqrt(power / samples))


def noise_floor(
    series: Sequence[Series], residuals: Sequence[Array], guard: Guard, substitutes: int
) -> tuple[float, str]:
    """Noise of the readings [output unit] and its source: "quiet", "repeats", or "unknown" with an upper bound.

    The noise is estimated from rests of the command, otherwise from its repeats. The diagnosed recordings come first,
    then the identification recordings. A misfit that repeats is no noise. The residual of a flexible model is the
    upper bound. The rounding of the converter is the lower bound: a coarse converter hides the noise at rest.

    Parameters
    ----------
    series, residuals
        Recordings and their residuals, shape (N,) each [output unit].
    guard
        Share that a flexible model could still explain.
    substitutes
        Number of series that replace missing recordings; they have no noise of their own.
    """
    files = list(zip(series, residuals, strict=True))[substitutes:]
    diagnosed = [pair for pair in files if pair[0].role == "recording"]
    rms = residual_rms(residuals, series)
    rounding_N = max(recording.lattice_N for recording, _ in diagnosed) / float(np.sqrt(12.0))
    unexplained_N = rms * float(np.sqrt(max(1.0 - guard.share, 0.0)))
    for group in (diagnosed, [pair for pair in files if pair[0].role != "recording"]):
        for noise_N, source in ((_noise_at_rest(group, unexplained_N), "quiet"), (_repeat_noise(group), "repeats")):
            if noise_N is not None:
                return min(max(noise_N, rounding_N), rms), source
    return min(max(unexplained_N, rounding_N), rms), UNKNOWN


def _noise_at_rest(files: Sequence[tuple[Series, Array]], unexplained_N: float) -> float | None:
    """Noise in rests of the command; from short rests up to `SLOW_NOISE` times more, as far as the residual allows."""
    for hold_s, most in ((HOLD_S, 1.0), (SHORT_HOLD_S, SLOW_NOISE)):
        quiet_N = [
            float(np.std(residual[rest]))
            for series, residual in files
            for rest in rests(series.command_V, series.counts, series.dt_s, hold_s)
        ]
        if len(quiet_N) >= FEWEST_HOLDS:
            value = float(np.sqrt(np.mean(np.square(quiet_N))))
            return max(value, min(most * value, unexplained_N))
    return None


def _repeat_noise(files: Sequence[tuple[Series, Array]]) -> float | None:
    """Noise from the differences of the residual between periods of the command."""
    noises = [noise_of(series.command_V, residual, series.counts, series.dt_s) for series, residual in files]
    values = [noise.rms for noise in noises if noise is not None and noise.seen_in == "repeats"]
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def structured_share(share: float, after: float, floor: float, *, above: bool) -> float:
    """Structured share of the squared residual [1].

    `share`: explainable share; `after`, `floor`: rms residual and noise. If the residual is `above` the noise, all of
    its excess is structured.
    """
    return max(share, 1.0 - (floor / after) ** 2) if above else share


def with_lower_confidence(finding: Finding, share: float, closed: float) -> Finding:
    """Finding with its confidence reduced in proportion to the structured residual.

    The confidence is multiplied by the explained share of explained error and structured residual. An effect that is
    read off the readings without a fit keeps its confidence.
    """
    if finding.before == finding.after:
        return finding
    explained, structured = max(finding.before**2 - finding.after**2, 0.0), share * finding.after**2
    factor = explained / (explained + structured) if share > MISSING_SHARE else 1.0
    partly = PARTLY_FACTOR * closed if closed < 1.0 else 1.0
    return replace(finding, confidence=finding.confidence * factor * partly)


def explainable_share(guard: Guard, motion: Motion) -> float:
    """Share of the squared residual that something could still explain [1]."""
    local = guard.local_share if guard.local_p < SIGNIFICANT else 0.0
    level = motion.level_share if motion.level_share > LEVEL_SHARE else 0.0
    return min(max(guard.share if guard.p < SIGNIFICANT else 0.0, motion.share, level, local), 1.0)


def shares_explained(result: Search, guard: Guard, motion: Motion) -> tuple[float, float]:
    """Share of the squared residual that something could still explain, and the explained share of the explainable."""
    share = explainable_share(guard, motion)
    before, after = (held_out_rms(result.chain, fitted) ** 2 for fitted in (result.base, result.hypothesis))
    before += tone_power(result.chain, result.diagnosed_tones)
    explainable_N2 = before - (1.0 - share) * after
    return share, float(np.clip((before - after) / explainable_N2, 0.0, 1.0)) if explainable_N2 > 0.0 else 1.0


def widest_range(series: Sequence[Series]) -> float:
    """Widest range of readings of a diagnosed recording [output unit]."""
    return max(float(np.ptp(s.reading_N[s.counts])) for s in series if s.role == "recording")


def verdict_of(
    share: float, closed: float, effects: Sequence[Finding | Base], *, above: bool, predicted: bool = False
) -> Verdict:
    """Verdict from the explainable share, the closed share and the highest_confidences.

    Parameters
    ----------
    above
        Whether the residual exceeds the noise: then something is missing, whether it is explainable or not.
    predicted
        Whether the given model has effects; without a difference it predicts the recordings.
    """
    missing = share > MISSING_SHARE or above
    if not effects:
        return "unexplained" if above or share > (PREDICTED_SHARE if predicted else MISSING_SHARE) else "matches"
    uncertain = missing and max(effect.confidence for effect in effects) < CONFIDENT
    partly = above or share > PARTLY_SHARE or (missing and closed < CLOSED) or uncertain
    return "partly_explained" if partly else "explained"


def tone_power(chain: Chain, tones: Sequence[Tone]) -> float:
    """Mean square of tones over the diagnosed recordings [output unit^2]."""
    samples = sum(series.time_s.size for series in chain.series if series.role == "recording")
    return sum(float(tone.signal_N @ tone.signal_N) for tone in tones) / samples


def residual_rms(residuals: Sequence[Array], series: Sequence[Series]) -> float:
    """Rms residual over the diagnosed recordings [output unit]."""
    squares = [np.square(r[s.counts]) for r, s in zip(residuals, series, strict=True) if s.role == "recording"]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def words_of(findings: Findings, wording: Wording) -> str:
    """Summary of the findings: opening, unchanged effects, errors, and residual."""
    parts = [effect_words(finding, wording) for finding in findings.effects]
    parts += [base_words(findings.base)] if findings.base.changed else []
    missing = "Something is missing that no effect of the catalogue explains"
    if findings.ended_early:
        missing = "Something is missing, and the time was over before all effects were compared"
    opening = {
        "matches": "The model matches the recordings",
        "explained": "; ".join(parts),
        "partly_explained": "; ".join(parts),
        "unexplained": missing,
        "not_testable": "The recordings do not excite the bench enough to tell"
        if findings.noise_is_known
        else "No effect is found, and the noise is unknown: the recordings cannot show that nothing is missing",
    }[findings.verdict]
    clauses = (opening, unchanged_words(findings.kept), _error_words(findings), _residual_words(findings))
    return "; ".join(clause for clause in clauses if clause)


def _residual_words(findings: Findings) -> str:
    """Clause about the residual; empty if the recordings do not suffice for a verdict."""
    if findings.verdict == "not_testable":
        return ""
    structured = findings.explainable > MISSING_SHARE
    if findings.verdict in ("matches", "explained") and not structured and not findings.above_noise:
        return "nothing is missing" if findings.verdict == "matches" else "nothing else is left"
    if findings.unrecorded is not None:
        return unrecorded_words(findings.unrecorded, findings.unit)
    if not structured and findings.above_noise:
        return "what is left is more than noise, and nothing tells what it is"
    return f"{100 * findings.explainable:.0f} % of what is left is no noise"


def _error_words(findings: Findings) -> str:
    """Clause about the simulation error before and after, and the noise."""
    unit = findings.unit
    text = f"error {findings.before:.3g} -> {findings.after:.3g} {unit}"
    if findings.refitted is not None:
        text += " with hysteresis and sampling refitted"
    if findings.after == findings.before:
        text = f"error {findings.before:.3g} {unit}"
    text += f", noise {findings.noise_text}"
    return text if findings.law is None else f"{text}, with {law_words(findings.law)}"
