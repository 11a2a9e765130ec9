"""Tones within a search: the strongest is removed where that gains, and all are fitted again when more is found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.candidates.tones import Tone, reestimated_tones, tones, with_tones, without_tones
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import worth
from piezod.diagnose.selection.search_state import Search
from piezod.estimation.recordings.noise import white_noise_of as noise_of
from piezod.estimation.recordings.series import Series

NEAR_A_MODE = 0.05  # relative distance in frequency within which a line is the ringing of a mode
TRIED = 2  # strongest tones that are tried
TONE_CHANGE = 0.2  # relative change of a tone's amplitude or frequency that machines show by themselves


@dataclass(frozen=True)
class RemovedTone:
    """A tone that may be removed.

    Parameters
    ----------
    chain, fitted
        Recordings without it, and the hypothesis there.
    """

    chain: Chain
    fitted: Fitted
    group: Sequence[Tone]


def strongest_tone(state: Search, *, only_known: bool = False) -> RemovedTone | None:
    """Strongest tone whose removal lowers the loss enough; `only_known`: near a tone of the given model."""
    residuals = residuals_of(state)
    for group in tones(state.chain.series, residuals, state.tones)[:TRIED]:
        if _near_a_mode(state, group[0]) or (only_known and not _is_known(state, group[0])):
            continue
        chain = state.chain.like(without_tones(state.chain.series, group))
        removed = RemovedTone(chain, fit(chain, state.hypothesis.terms, state.hypothesis.point, most_steps=6), group)
        if worth(state.hypothesis, removed.fitted) or dominates(state, removed):
            return removed
    return None


def without_known_tones(state: Search) -> Search:
    """State without the tones of the given model in the readings: their phase differs in each recording."""
    for _ in state.known_tones_Hz:
        removed = strongest_tone(state, only_known=True)
        if removed is None:
            break
        state = subtract(state, removed)
    return state


def _is_known(state: Search, tone: Tone) -> bool:
    return any(abs(tone.values["frequency_Hz"] / known_Hz - 1.0) < TONE_CHANGE for known_Hz in state.known_tones_Hz)


def residuals_of(state: Search) -> list[Array]:
    """Residuals of all samples, an array of shape (N,) per recording [N]."""
    modelled_N = Normal.at(state.chain, state.hypothesis.terms, state.hypothesis.point).readings()
    return [series.reading_N - model_N for series, model_N in zip(state.chain.series, modelled_N, strict=True)]


def _near_a_mode(state: Search, tone: Tone) -> bool:
    """Whether the hypothesis has a mode at the frequency of a tone."""
    modes_Hz = [
        values["frequency_Hz"]
        for term, values in zip(state.hypothesis.terms, state.hypothesis.point.values, strict=True)
        if "frequency_Hz" in values and term.effect.form == "linear"
    ]
    return any(abs(tone.values["frequency_Hz"] / mode_Hz - 1.0) < NEAR_A_MODE for mode_Hz in modes_Hz)


def dominates(state: Search, removed: RemovedTone) -> bool:
    """Whether a tone is most of the loss of its recordings."""
    numbers = {tone.number for tone in removed.group}
    series = state.chain.series
    blocks = np.repeat([k in numbers for k in range(len(series))], [len(one.blocks) for one in series])
    before, after = (fit.losses[blocks] @ fit.samples[blocks] for fit in (state.hypothesis, removed.fitted))
    return bool(after < RULES.dominant_tone * before)


def subtract(state: Search, removed: RemovedTone) -> Search:
    """State without a tone in the readings."""
    state = replace(state, tones=(*state.tones, *removed.group))
    return _refitted(state, removed.chain.series, removed.group)


def update_tones(state: Search) -> Search:
    """State with the tones fitted again, because the first fit contained effects that were not known then."""
    state = _give_back(state)
    if not state.tones:
        return state
    series = state.chain.series
    again = reestimated_tones(series, residuals_of(state), state.tones)
    whole = with_tones(series, state.tones)
    return _refitted(replace(state, tones=tuple(again)), without_tones(whole, again), again)


def _give_back(state: Search) -> Search:
    """State with the tones near a mode in the readings again, where the mode explains them as well."""
    near = [tone for tone in state.tones if _near_a_mode(state, tone)]
    others = tuple(tone for tone in state.tones if not _near_a_mode(state, tone))
    if not near:
        return state
    chain = state.chain.like(with_tones(state.chain.series, near))
    fitted = fit(chain, state.hypothesis.terms, state.hypothesis.point)
    if RULES.better * fitted.loss >= state.hypothesis.loss:
        return state
    return state.on_chain(chain, fitted, tones=others)


def _refitted(state: Search, series: Sequence[Series], removed: Sequence[Tone]) -> Search:
    """State on other readings; the noise is estimated again, because it may have held the tone."""
    series = list(series)
    for number in {tone.number for tone in removed}:
        recording = series[number]
        if recording.trust is None:
            noise_N = noise_of(recording.command_V, recording.reading_N, recording.counts)
            series[number] = replace(recording, noise_N=noise_N)
    chain = state.chain.like(series)
    return state.on_chain(chain, fit(chain, state.hypothesis.terms, state.hypothesis.point))
