"""The verdict: what is left beside what was explained, how sure the names are then, and all of it in words."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.adequacy.guard import Guard
from piezod.diagnose.adequacy.remainder import Motion
from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.findings import UNKNOWN, Base, Finding, Findings, Verdict
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.verdict.words import Wording, base_words, effect_words, kept_words, law_words, unrecorded_words
from piezod.estimation.noise import noise_of

Array = NDArray[np.float64]

STILL_EXPLAINABLE = 0.1  # share of what is left, from which a verdict says that something is missing
MUCH_EXPLAINABLE = 0.75  # the same, from which it is said whatever was explained: twice the noise is left
BY_LEVEL = 0.25  # share of what is left that must lie above that at the lowest force
SURE = 0.01  # p below which that share is believed
CLOSED = 0.97  # part of what could be explained, from which it counts as explained
BELIEVED = 0.5  # confidence that one of the names must have where something is left
FEWEST_HOLDS = 3
RECORD_NOISE = (
    "the noise is unknown, since the command neither rests nor repeats: record three holds of half a second at "
    "different levels, or drive the same course twice"
)
HOLD_S, SHORT_HOLD_S = 0.5, 0.15  # of the rests that tell the noise
SLOWER = 1.5  # times the noise in short rests that all noise has at most: where half of its power is slower, 1.41
PARTLY = 0.9  # most that a name is believed whose effect leaves much to explain


def held_out_rms(chain: Chain, fitted: Fitted) -> float:
    """Of blocks left out, over the recordings asked about [output unit]."""
    powers, samples, first = 0.0, 0.0, 0
    for series in chain.series:
        part = slice(first, first + len(series.blocks))
        first += len(series.blocks)
        if series.role == "recording":
            powers += float(fitted.losses[part] @ fitted.samples[part]) * series.noise_N**2
            samples += float(fitted.samples[part].sum())
    return float(np.sqrt(powers / samples))


def noise_floor(series: Sequence[Series], residuals: Sequence[Array], left: Guard, stand_ins: int) -> tuple[float, str]:
    """Noise of the readings [output unit], and where it shows; "unknown" with an upper bound where it shows nowhere.

    It shows where the command rests, else where it repeats, first in the recordings asked about, then in those of the
    identification. A misfit that repeats is no noise. What a flexible model leaves is the upper bound. The noise is no
    less than a converter's rounding: a coarse one hides all noise at rest, not while the force moves.

    Parameters
    ----------
    series, residuals
        The recordings, and what the found model leaves of their readings, shape (N,) each [output unit].
    left
        What a flexible model could still explain.
    stand_ins
        How many series stand for recordings that are gone; they have no noise of their own.
    """
    files = list(zip(series, residuals, strict=True))[stand_ins:]
    asked = [one for one in files if one[0].role == "recording"]
    rms = rms_of(residuals, series)
    rounding_N = max(one.lattice_N for one, _ in asked) / float(np.sqrt(12.0))
    unexplained_N = rms * float(np.sqrt(max(1.0 - left.share, 0.0)))
    for some in (asked, [one for one in files if one[0].role != "recording"]):
        for found, where in ((_at_rest(some, unexplained_N), "quiet"), (_in_repeats(some), "repeats")):
            if found is not None:
                return min(max(found, rounding_N), rms), where
    return min(max(unexplained_N, rounding_N), rms), UNKNOWN


def _at_rest(files: Sequence[tuple[Series, Array]], unexplained_N: float) -> float | None:
    """Noise in rests of the command; short ones hide slow noise, so up to 1.5 times theirs, if so much is left."""
    for hold_s, most in ((HOLD_S, 1.0), (SHORT_HOLD_S, SLOWER)):
        quiet = [value for one, residual in files for value in _holds(one, residual, hold_s)]
        if len(quiet) >= FEWEST_HOLDS:
            value = float(np.sqrt(np.mean(np.square(quiet))))
            return max(value, min(most * value, unexplained_N))
    return None


def _in_repeats(files: Sequence[tuple[Series, Array]]) -> float | None:
    """Noise from the differences of the residual between periods of the command."""
    seen = [noise_of(one.command_V, residual, one.counts, one.dt_s) for one, residual in files]
    values = [noise.rms for noise in seen if noise is not None and noise.seen_in == "repeats"]
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _holds(series: Series, residual: Array, hold_s: float) -> list[float]:
    """Standard deviation of the residual in every stretch of a duration in which the command rests."""
    size = max(int(hold_s / series.dt_s), 20)
    found = []
    for first in range(0, series.command_V.size - size, size):
        part = slice(first, first + size)
        if np.ptp(series.command_V[part]) == 0.0 and series.counts[part].all():
            found.append(float(np.std(residual[part])))
    return found


def no_noise(share: float, after: float, floor: float, *, above: bool) -> float:
    """Share of the squared error that is left and is no noise: what could be explained, or all `above` the floor.

    Parameters
    ----------
    share
        That something could explain.
    after, floor
        Error that is left, and noise [output unit].
    above
        Whether that is more than noise.
    """
    return max(share, 1.0 - (floor / after) ** 2) if above else share


def less_sure(one: Finding, share: float, closed: float) -> Finding:
    """The same, believed less where as much is left to explain as it explains."""
    own, left = max(one.before**2 - one.after**2, 0.0), share * one.after**2
    if one.before == one.after:  # read off the readings: no fit says anything
        return one
    alone = own / (own + left) if share > STILL_EXPLAINABLE else 1.0
    return replace(one, confidence=one.confidence * alone * (PARTLY * closed if closed < 1.0 else 1.0))


def share_left(left: Guard, moving: Motion) -> float:
    """Share of what is left that something could still explain."""
    local = left.local_share if left.local_p < SURE else 0.0
    by_level = moving.level_share if moving.level_share > BY_LEVEL else 0.0
    return min(max(left.share if left.p < SURE else 0.0, moving.share, by_level, local), 1.0)


def remaining(result: Search, left: Guard, moving: Motion) -> tuple[float, float]:
    """Share of what is left that something could still explain, and how much of all that could be explained was."""
    share = share_left(left, moving)
    before, after = (held_out_rms(result.chain, one) ** 2 for one in (result.base, result.found))
    before += power_of(result.chain, result.tones_asked_about)
    explainable_N2 = before - (1.0 - share) * after
    return share, float(np.clip((before - after) / explainable_N2, 0.0, 1.0)) if explainable_N2 > 0.0 else 1.0


def span_of(series: Sequence[Series]) -> float:
    """Widest range of readings of a recording asked about [output unit]."""
    return max(float(np.ptp(one.reading_N[one.counts])) for one in series if one.role == "recording")


def verdict_of(share: float, closed: float, effects: Sequence[Finding | Base], *, above: bool) -> Verdict:
    """From what is left to explain, how much of all that could be was explained, and how far the names are believed.

    `above` says that more than noise is left: then something is missing though nothing tells what it is.
    """
    missing = share > STILL_EXPLAINABLE or above
    if not effects:
        return "unexplained" if missing else "matches"
    doubted = missing and max(one.confidence for one in effects) < BELIEVED
    partly = above or share > MUCH_EXPLAINABLE or (missing and closed < CLOSED) or doubted
    return "partly_explained" if partly else "explained"


def power_of(chain: Chain, tones: Sequence[Tone]) -> float:
    """Of tones, over the recordings asked about."""
    samples = sum(one.time_s.size for one in chain.series if one.role == "recording")
    return sum(float(tone.heard_N @ tone.heard_N) for tone in tones) / samples


def rms_of(residuals: Sequence[Array], series: Sequence[Series]) -> float:
    """Over the recordings asked about."""
    squares = [np.square(r[s.counts]) for r, s in zip(residuals, series, strict=True) if s.role == "recording"]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def words_of(findings: Findings, wording: Wording) -> str:
    """The verdict in a few sentences."""
    parts = [effect_words(one, wording) for one in findings.effects]
    parts += [base_words(findings.base)] if findings.base.changed else []
    opening = {
        "matches": "The model matches the recordings",
        "explained": "; ".join(parts),
        "partly_explained": "; ".join(parts),
        "unexplained": "Something is missing that no effect of the catalogue explains",
        "not_testable": "The recordings do not excite the bench enough to tell",
    }[findings.verdict]
    more = f"{100 * findings.explainable:.0f} % of what is left is no noise"
    if findings.explainable <= STILL_EXPLAINABLE and findings.above_noise:
        more = "what is left is more than noise, and nothing tells what it is"
    done = findings.explainable <= STILL_EXPLAINABLE and not findings.above_noise
    if findings.unrecorded is not None:
        more = unrecorded_words(findings.unrecorded, findings.unit)
    rest = {
        "matches": "nothing is missing" if done else more,
        "explained": "nothing else is left" if done else more,
        "partly_explained": more,
        "unexplained": more,
    }.get(findings.verdict)
    return "; ".join(one for one in (opening, kept_words(findings.kept), _error_words(findings), rest) if one)


def _error_words(findings: Findings) -> str:
    """The error that simulation leaves, before and after."""
    unit = findings.unit
    told = f"error {findings.before:.3g} -> {findings.after:.3g} {unit}"
    if findings.refitted is not None:
        told += " with hysteresis and sampling refitted"
    if findings.after == findings.before:
        told = f"error {findings.before:.3g} {unit}"
    told += f", noise {findings.noise_text}"
    return told if findings.law is None else f"{told}, with {law_words(findings.law)}"
