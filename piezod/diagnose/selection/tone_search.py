"""Tones in a search: the strongest one is subtracted if that pays, and all are estimated again after a new effect."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import noise_of
from piezod.diagnose.candidates.tones import Tone, reestimated_tones, tones, with_tones, without_tones
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.selection.acceptance import BETTER, worth
from piezod.diagnose.selection.search_state import Search

Array = NDArray[np.float64]

NEAR_A_MODE = 0.05  # relative distance from a resonance below which a line is its ringing
DOMINANT = 0.3  # loss ratio of its recordings below which a tone is subtracted before effects are tried

ToneTrial = tuple[Chain, Fitted, list[Tone]]
"""Recordings without the tones of a group, the hypothesis refitted to them, and the tones."""


def strongest_tone(result: Search) -> ToneTrial | None:
    """Trial with the strongest group of tones that lowers the loss enough; None if there is none."""
    for group in tones(result.chain.series, _residuals(result), result.tones)[:2]:
        if _is_near_a_mode(result, group[0]):
            continue
        chain = result.chain.like(without_tones(result.chain.series, group))
        fitted = fit(chain, result.hypothesis.terms, result.hypothesis.point, most_steps=6)
        trial = chain, fitted, group
        if worth(result.hypothesis, fitted) or dominates(result, trial):
            return trial
    return None


def _residuals(result: Search) -> list[Array]:
    readings = Normal.at(result.chain, result.hypothesis.terms, result.hypothesis.point).readings()
    return [series.reading_N - modelled for series, modelled in zip(result.chain.series, readings, strict=True)]


def _is_near_a_mode(result: Search, tone: Tone) -> bool:
    modes_Hz = [
        values["frequency_Hz"]
        for term, values in zip(result.hypothesis.terms, result.hypothesis.point.values, strict=True)
        if term.effect.name == "resonance"
    ]
    return any(abs(tone.values["frequency_Hz"] / mode_Hz - 1.0) < NEAR_A_MODE for mode_Hz in modes_Hz)


def dominates(result: Search, trial: ToneTrial) -> bool:
    """Whether a tone explains most of the loss of its own recordings."""
    chain, fitted, group = trial
    numbers = {tone.number for tone in group}
    affected = np.repeat([k in numbers for k in range(len(chain.series))], [len(s.blocks) for s in chain.series])
    before, after = (h.losses[affected] @ h.samples[affected] for h in (result.hypothesis, fitted))
    return bool(after < DOMINANT * before)


def subtract(result: Search, trial: ToneTrial) -> None:
    """Subtract the tones of a trial."""
    chain, _, group = trial
    result.tones += group
    _continue_with(result, chain.series, group)


def update_tones(result: Search) -> None:
    """Estimate the subtracted tones again: the first estimate contained a part of the effects found since."""
    if not result.tones:
        return
    _restore_ringing(result)
    if not result.tones:
        return
    series = result.chain.series
    updated = reestimated_tones(series, _residuals(result), result.tones)
    restored = with_tones(series, result.tones)
    result.tones = updated
    _continue_with(result, without_tones(restored, updated), updated)


def _restore_ringing(result: Search) -> None:
    """Add tones near a resonance to the readings again, if the resonance explains them as well."""
    ringing = [tone for tone in result.tones if _is_near_a_mode(result, tone)]
    others = [tone for tone in result.tones if not _is_near_a_mode(result, tone)]
    if not ringing:
        return
    chain = result.chain.like(with_tones(result.chain.series, ringing))
    fitted = fit(chain, result.hypothesis.terms, result.hypothesis.point)
    if BETTER * fitted.loss < result.hypothesis.loss:
        result.chain, result.hypothesis = chain, fitted
        result.base = fit(chain, result.base.terms, result.base.point)
        result.tones = others


def _continue_with(result: Search, series: Sequence[Series], subtracted: Sequence[Tone]) -> None:
    """Refit hypothesis and base to these readings; the noise without the tones is estimated again."""
    series = list(series)
    for number in {tone.number for tone in subtracted}:
        recording = series[number]
        if recording.trust is None:
            noise_N = noise_of(recording.command_V, recording.reading_N, recording.counts)
            series[number] = replace(recording, noise_N=noise_N)
    result.chain = result.chain.like(series)
    result.hypothesis = fit(result.chain, result.hypothesis.terms, result.hypothesis.point)
    result.base = fit(result.chain, result.base.terms, result.base.point)
