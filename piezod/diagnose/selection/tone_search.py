"""Tones within a search: the strongest taken off where that pays, and all followed anew when more is found."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.direct import noise_of
from piezod.diagnose.candidates.tones import Tone, heard_again, tones, with_tones, without_tones
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.selection.acceptance import BETTER, worth
from piezod.diagnose.selection.search_state import Search

NEAR_A_MODE = 0.05  # of its frequency: a line there is its own ringing
DOMINANT = 0.3  # of its recordings' loss: a tone without which so little is left is taken off before all else is tried

Heard = tuple[Chain, Fitted, list[Tone]]


def heard(result: Search) -> Heard | None:
    """The strongest tone taken off, where that lowers the loss enough."""
    normal = Normal.at(result.chain, result.found.terms, result.found.point)
    residuals = [one.reading_N - modelled for one, modelled in zip(result.chain.series, normal.readings(), strict=True)]
    for group in tones(result.chain.series, residuals, result.tones)[:2]:
        if _near_a_mode(result, group[0]):
            continue
        chain = result.chain.like(without_tones(result.chain.series, group))
        fitted = fit(chain, result.found.terms, result.found.point, most_steps=6)
        candidate = chain, fitted, group
        if worth(result.found, fitted) or dominates(result, candidate):
            return candidate
    return None


def _near_a_mode(result: Search, tone: Tone) -> bool:
    modes_Hz = [
        values["frequency_Hz"]
        for term, values in zip(result.found.terms, result.found.point.values, strict=True)
        if term.effect.name == "resonance"
    ]
    return any(abs(tone.values["frequency_Hz"] / mode_Hz - 1.0) < NEAR_A_MODE for mode_Hz in modes_Hz)


def dominates(result: Search, candidate: Heard) -> bool:
    """Whether a tone is most of what is left of its recordings; beside others it may be lost in what they lack."""
    chain, without, group = candidate
    mine = {tone.number for tone in group}
    parts = np.repeat([k in mine for k in range(len(chain.series))], [len(one.blocks) for one in chain.series])
    before, after = (one.losses[parts] @ one.samples[parts] for one in (result.found, without))
    return bool(after < DOMINANT * before)


def listen(result: Search, new: Heard) -> None:
    """Take a tone off."""
    chain, _, group = new
    result.tones += group
    _without_tones(result, chain.series, group)


def listen_again(result: Search) -> None:
    """Follow the tones anew: what was taken off while more was missing was not the tone alone."""
    _give_back(result)
    if not result.tones:
        return
    normal = Normal.at(result.chain, result.found.terms, result.found.point)
    series = result.chain.series
    left = [one.reading_N - modelled for one, modelled in zip(series, normal.readings(), strict=True)]
    again = heard_again(series, left, result.tones)
    back = with_tones(series, result.tones)
    result.tones = again
    _without_tones(result, without_tones(back, again), again)


def _give_back(result: Search) -> None:
    """Put back what was taken off near a mode that was found since, where the mode explains it as well."""
    mine = [tone for tone in result.tones if _near_a_mode(result, tone)]
    others = [tone for tone in result.tones if not _near_a_mode(result, tone)]
    if not mine:
        return
    chain = result.chain.like(with_tones(result.chain.series, mine))
    fitted = fit(chain, result.found.terms, result.found.point)
    if BETTER * fitted.loss < result.found.loss:
        result.chain, result.found = chain, fitted
        result.base = fit(chain, result.base.terms, result.base.point)
        result.tones = others


def _without_tones(result: Search, series: Sequence[Series], heard: Sequence[Tone]) -> None:
    """Go on with these readings; what was counted as noise before may have been a tone."""
    series = list(series)
    for number in {tone.number for tone in heard}:
        one = series[number]
        if one.trust is None:
            series[number] = replace(one, noise_N=noise_of(one.command_V, one.reading_N, one.counts))
    result.chain = result.chain.like(series)
    result.found = fit(result.chain, result.found.terms, result.found.point)
    result.base = fit(result.chain, result.base.terms, result.base.point)
