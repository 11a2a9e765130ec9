"""Findings about tones, which are subtracted from the readings instead of fitted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.direct import level_about
from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.findings import Finding, Value
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.record import place_of
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.tone_search import TONE_CHANGE
from piezod.diagnose.verdict.evidence import NORMAL_95, confidence_of, finding_about, given_values
from piezod.diagnose.verdict.verdict import held_out_rms, tone_power
from piezod.effects import EFFECTS
from piezod.model import Model

GONE = 0.5  # largest amplitude that a gone tone may still have, relative to the given model


def with_tone_terms(fitted: Fitted, tones: Sequence[Tone]) -> Fitted:
    """Hypothesis with the tones as effects of scope "once"."""
    terms = tuple(Term(EFFECTS[tone.name], "once", tone.number) for tone in tones)
    values = (*fitted.point.values, *(tone.values for tone in tones))
    return replace(fitted, terms=(*fitted.terms, *terms), point=replace(fitted.point, values=values))


def tone_finding(result: Search, name: str, given: Model | None = None) -> Finding:
    """Finding about a tone; a tone of the given model is recognised by amplitude and frequency, not by phase."""
    effect, after = EFFECTS[name], held_out_rms(result.chain, result.hypothesis)
    was = {} if given is None or name not in {known.name for known in given.effects} else given_values(given, name)
    tones = [tone for tone in result.diagnosed_tones if tone.name == name]
    parameters = {}
    for parameter in effect.catalogued:
        values = np.array([tone.values[parameter.name] for tone in tones])
        is_amplitude = parameter.name == "amplitude_N"
        depth = max(tone.values.get("breathing_depth", 0.0) for tone in tones) if is_amplitude else 0.0
        error = _tone_error(parameter.name, tones[0], result) + depth * float(values.mean())
        low, high = float(values.min()) - error, float(values.max()) + error
        parameters[parameter.name] = Value(float(values.mean()), parameter.unit, low, high)
    before = float(np.sqrt(after**2 + tone_power(result.chain, tones)))
    finding = finding_about(
        effect,
        confidence_of(2.0 * float(np.log(before / after)), ()),
        "once",
        place_of(Term(effect, "once", tones[0].number), tones[0].values, result.chain),
        parameters,
        (before, after),
    )
    return replace(finding, status="changed" if was else "new", was=was)


def is_unchanged_tone(tone: Finding) -> bool:
    """Whether a tone of the given model has not changed."""
    pairs = [(tone.parameters[name], was) for name, was in tone.was.items()]
    return bool(pairs) and all(abs(now.value / was.value - 1.0) < TONE_CHANGE for now, was in pairs)


def gone_tones(result: Search, given: Model) -> list[Finding]:
    """Findings about tones of the given model that the diagnosed recordings would show and do not.

    The upper end of the amplitude at the tone's frequency is below `GONE` of the lower end in the given model.
    """
    found = {tone.name for tone in result.diagnosed_tones}
    names = dict.fromkeys(effect.name for effect in given.effects if EFFECTS[effect.name].is_tone)
    return [_gone_tone(result, name, given) for name in names if name not in found and _is_gone(result, name, given)]


def _is_gone(result: Search, name: str, given: Model) -> bool:
    was = given_values(given, name)
    frequency_Hz, least_N = was["frequency_Hz"].value, GONE * was["amplitude_N"].low
    diagnosed = [k for k, series in enumerate(result.chain.series) if series.role == "recording"]
    return all(_highest_amplitude_N(result, number, frequency_Hz) < least_N for number in diagnosed)


def _highest_amplitude_N(result: Search, number: int, frequency_Hz: float) -> float:
    """Upper end of the amplitude of a tone within `TONE_CHANGE` of a frequency [N]; inf where the rate is too low."""
    series = result.chain.series[number]
    if frequency_Hz * (1.0 + TONE_CHANGE) * series.dt_s >= 0.5:
        return np.inf
    modelled_N = result.chain.run(number, result.hypothesis.terms, result.hypothesis.point).reading_N
    residual_N = np.where(series.counts, series.reading_N - modelled_N, 0.0)
    window = np.hanning(residual_N.size)
    amplitudes_N = 2.0 * np.abs(np.fft.rfft((residual_N - residual_N.mean()) * window)) / window.sum()
    near = np.abs(np.fft.rfftfreq(residual_N.size, series.dt_s) / frequency_Hz - 1.0) < TONE_CHANGE
    error_N = NORMAL_95 * series.noise_N * float(np.sqrt(2.0 / residual_N.size))
    return float(amplitudes_N[near].max(initial=0.0)) + error_N


def _gone_tone(result: Search, name: str, given: Model) -> Finding:
    """Finding about a tone that is gone; the errors are equal, because the given model does not know its phase."""
    effect, was = EFFECTS[name], given_values(given, name)
    rms = held_out_rms(result.chain, result.hypothesis)
    confidence = confidence_of(float(np.log(1.0 + 0.5 * (was["amplitude_N"].value / rms) ** 2)), ())
    return replace(finding_about(effect, confidence, "once", (), was, (rms, rms)), status="gone", was=was)


def _tone_error(name: str, tone: Tone, result: Search) -> float:
    """Half of the 95 % interval of a tone's amplitude [N] or frequency [Hz].

    Cramer-Rao bound for white noise of the spectral density that the residual has around the tone.
    """
    series = result.chain.series[tone.number]
    modelled_N = result.chain.run(tone.number, result.hypothesis.terms, result.hypothesis.point).reading_N
    frequency_Hz, amplitude_N = tone.values["frequency_Hz"], max(tone.values["amplitude_N"], 1e-300)
    noise_N = level_about(series, series.reading_N - modelled_N, frequency_Hz)
    error = NORMAL_95 * noise_N * float(np.sqrt(2.0 / series.time_s.size))
    if name == "amplitude_N":
        return error
    return error / amplitude_N * float(np.sqrt(12.0)) / (2.0 * np.pi * max(series.duration_s, 1e-9))
