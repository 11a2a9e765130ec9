"""What speaks for each effect that was found: parameters, errors without it and with it, rivals, confidence."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.direct import level_about
from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.findings import Base, Finding, Kept, Place, Rival, Value
from piezod.diagnose.hypothesis.chain import Term
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.hypothesis.stack_change import NAMES
from piezod.diagnose.selection.acceptance import counted
from piezod.diagnose.selection.given_effects import as_given, without_effect
from piezod.diagnose.selection.search import fitted_without
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.significance import p_value
from piezod.diagnose.verdict.places import place_of
from piezod.diagnose.verdict.verdict import held_out_rms, power_of
from piezod.effects import EFFECTS, Parameter
from piezod.effects.noncongruent_minor_loops import DEGREES
from piezod.model import Model

Array = NDArray[np.float64]

RIVAL = 0.8  # part of the winner's gain, from which another effect is a rival
NORMAL_95 = 1.96
WIDER, OFF = 2.0, 0.015
"""Times the half of an interval that blocks left out tell, and part of a value, that the form of the model is off by.
Chosen by 24 parameters of 33 concealed benches: 13 lay within the intervals of the blocks alone, 21 within these."""
MOST_SPREAD = 20.0  # of an interval on its scale: beyond it a parameter is not determined
BENT = 1.0 / 8.0  # of a sample, by which a delay between samples may be off
UNLIKE = 2.0  # noises from the model, root mean square: a reading that stands still while the force moves is further
BREATHES = 0.2  # of its amplitude: so much that of a machine changes by itself
COARSE = 0.5  # of the other noise: a converter's step / sqrt(12) beyond it is a finding


def finding_of(result: Search, name: str, given: Model | None = None) -> Finding:
    """An effect that was fitted: its parameters, and the errors on blocks left out without it and with it.

    Of an effect that the given model has, the errors are those with its old and with its new values.
    """
    chain, found = result.chain, result.found
    place = next(k for k, term in enumerate(found.terms) if term.effect.name == name)
    term, values = found.terms[place], found.point.values[place]
    if name in result.given:
        fewer = as_given(chain, found, result.base, name)
    else:
        fewer = fitted_without(chain, found, name) if len(found.effects) > 1 else result.base
    parameters, acts_in = {}, chain.series[term.series]
    for one in term.effect.catalogued:
        value = {**values, **dict(term.choices)}[one.name]
        in_fit = _ends(one, value, min(NORMAL_95 * found.spread[place].get(one.name, 0.0), MOST_SPREAD))
        if one.instant and value > acts_in.duration_s:
            continue  # never: what began stays
        begin_s = acts_in.start_s if one.instant else 0.0
        low, high = in_fit if one.instant else _with_the_form(one, value, in_fit)
        parameters[one.name] = Value(begin_s + value, one.unit, begin_s + low, begin_s + high, in_fit)
    if term.effect.name == "transport_delay":
        smoothed = any(other.effect.smooths for other in found.terms)
        parameters["delay_s"] = _with_the_course(parameters["delay_s"], chain.series[-1], smoothed=smoothed)
    if term.effect.name == "noncongruent_minor_loops":
        parameters["share"] = _share(result, place)
    rivals = _rivals(result, term)
    gain = float(np.log(fewer.loss / found.loss))
    return Finding(
        term.effect.name,
        term.effect.title,
        _confidence(gain, rivals),
        term.scope,
        place_of(term, values, chain),
        parameters,
        held_out_rms(chain, fewer),
        held_out_rms(chain, found),
        rivals,
        term.effect.handling,
        term.effect.why,
        p_value(result, fewer, name),
        status="changed" if name in result.given else "new",
        was={} if given is None or name not in result.given else given_values(given, name),
    )


def _ends(one: Parameter, value: float, error: float) -> tuple[float, float]:
    """Ends of an interval whose half is known on the scale of the search, within the range of the parameter."""
    ends = (value * np.exp(-error), value * np.exp(error)) if one.search.logarithmic else (value - error, value + error)
    return float(max(ends[0], one.low)), float(min(ends[1], one.high))


def _with_the_form(one: Parameter, value: float, in_fit: tuple[float, float]) -> tuple[float, float]:
    """The interval with what the form of the model is off by, which no block that is left out tells."""
    low, high = (
        value + side * np.hypot(WIDER * (end - value), OFF * value) for side, end in zip((-1, 1), in_fit, strict=True)
    )
    if one.low >= 0.0:
        low = min(max(low, value**2 / high), in_fit[0])  # as a factor no more below than above
    return float(max(low, one.low)), float(min(high, one.high))


def gone_finding(result: Search, name: str, given: Model) -> Finding:
    """An effect of the given model that the recordings do not show: errors on blocks left out with it and without it.

    Its parameters are those of the given model.
    """
    chain, found = result.chain, result.found
    with_it = as_given(chain, found, result.base, name)
    effect, was = EFFECTS[name], given_values(given, name)
    return Finding(
        name,
        effect.title,
        _confidence(float(np.log(with_it.loss / found.loss)), ()),
        next(term.scope for term in result.base.terms if term.effect is effect),
        (),
        was,
        held_out_rms(chain, with_it),
        held_out_rms(chain, found),
        (),
        effect.handling,
        effect.why,
        p_value(result, with_it, name),
        status="gone",
        was=was,
    )


def base_of(result: Search) -> Base:
    """What has become of the stack itself."""
    if not result.stack_changed:
        return Base()
    chain, found = result.chain, result.found
    values, before = {}, found
    for name in NAMES:
        place = next((k for k, term in enumerate(found.terms) if term.effect.name == name), None)
        if place is not None:
            before = without_effect(chain, before, name)
            value, error = found.point.values[place][name], NORMAL_95 * found.spread[place].get(name, 0.0)
            values[name] = Value(value, "1", value * float(np.exp(-error)), value * float(np.exp(error)))
    asked = [one.command_V for one in chain.series if one.role == "recording"]
    place_V = Place("voltage_V", min(float(one.min()) for one in asked), max(float(one.max()) for one in asked))
    confidence = _confidence(float(np.log(before.loss / found.loss)), ())
    return Base(True, values.get("gain"), values.get("loops"), (place_V,), confidence)


def given_values(given: Model, name: str) -> dict[str, Value]:
    """Parameters of an effect of the given model, with their intervals where the model states them."""
    entry = next(one for one in given.effects if one.name == name)
    found = {}
    for one in EFFECTS[name].catalogued:
        value = entry.parameters.get(one.name, one.search.starts[0] if one.search.starts else 0.0)
        low, high = (entry.intervals or {}).get(one.name, (value, value))
        found[one.name] = Value(value, one.unit, low, high)
    return found


def kept_effects(result: Search, given: Model, found: Sequence[Finding], tones: Sequence[str]) -> list[Kept]:
    """Effects of the given model that have not changed, those of other recordings too.

    Parameters
    ----------
    result, given
        Search and given model.
    found
        What is new, changed or gone.
    tones
        Tones that have not changed.
    """
    different = {one.name for one in found}
    names = [name for name in dict.fromkeys(entry.name for entry in given.effects) if name not in different]
    seen = {name for name, status in result.statuses.items() if status == "kept"} | set(tones)
    return [Kept(name, given_values(given, name), name in seen) for name in names]


def _with_the_course(delay_s: Value, series: Series, *, smoothed: bool) -> Value:
    """A delay whose interval holds what nobody can tell from it.

    That is for how much of a sample a command was held before the reading, where the recording does not say so; and
    when within a sample a held command comes, where nothing smooths its steps. Where a lag does, the delay is taken
    straight between samples and the lag's curve bends: at most f (1 - f) / 2 of a sample for its part f.
    """
    told, held = series.hold == series.recorded_hold, not series.hold.straight
    within_s = (BENT if smoothed else 1.0) * series.dt_s if held else 0.0
    shorter_s, longer_s = (
        (0.0, 0.0) if told else (series.hold.read_after * series.dt_s, (1.0 - series.hold.read_after) * series.dt_s)
    )
    return replace(delay_s, low=max(delay_s.low - shorter_s - within_s, 0.0), high=delay_s.high + longer_s + within_s)


def all_terms(found: Fitted, tones: Sequence[Tone]) -> Fitted:
    """The hypothesis with the tones as effects that happened once."""
    terms = tuple(Term(EFFECTS[tone.name], "once", tone.number) for tone in tones)
    values = (*found.point.values, *(tone.values for tone in tones))
    return replace(found, terms=(*found.terms, *terms), point=replace(found.point, values=values))


def tone_finding(result: Search, name: str, given: Model | None = None) -> Finding:
    """A tone as a finding.

    Every recording has its own phase. The tone of the given model is known by its amplitude and frequency.
    """
    effect, after = EFFECTS[name], held_out_rms(result.chain, result.found)
    was = {} if given is None or name not in {one.name for one in given.effects} else given_values(given, name)
    mine = [tone for tone in result.tones_asked_about if tone.name == name]
    parameters = {}
    for one in effect.catalogued:
        values = np.array([tone.values[one.name] for tone in mine])
        breathing = max(t.values.get("breathing_depth", 0.0) for t in mine) if one.name == "amplitude_N" else 0.0
        error = _tone_error(one.name, mine[0], result) + breathing * float(values.mean())
        low, high = float(values.min()) - error, float(values.max()) + error
        parameters[one.name] = Value(float(values.mean()), one.unit, low, high)
    before = float(np.sqrt(after**2 + power_of(result.chain, mine)))
    return Finding(
        effect.name,
        effect.title,
        _confidence(2.0 * float(np.log(before / after)), ()),
        "once",
        place_of(Term(effect, "once", mine[0].number), mine[0].values, result.chain),
        parameters,
        before,
        after,
        (),
        effect.handling,
        effect.why,
        status="changed" if was else "new",
        was=was,
    )


def same_tone(tone: Finding) -> bool:
    """Whether a tone of the given model has not changed."""
    pairs = [(tone.parameters[name], was) for name, was in tone.was.items()]
    return bool(pairs) and all(abs(now.value / was.value - 1.0) < BREATHES for now, was in pairs)


def _tone_error(name: str, tone: Tone, result: Search) -> float:
    """Half of the 95 % interval of a tone's amplitude [N] or frequency [Hz] in what is left of its colour.

    Cramer and Rao's bound, for white noise of the density that the residual has about the tone.
    """
    series = result.chain.series[tone.number]
    modelled_N = result.chain.run(tone.number, result.found.terms, result.found.point).reading_N
    frequency_Hz, amplitude_N = tone.values["frequency_Hz"], max(tone.values["amplitude_N"], 1e-300)
    noise_N = level_about(series, series.reading_N - modelled_N, frequency_Hz)
    error = NORMAL_95 * noise_N * float(np.sqrt(2.0 / series.time_s.size))
    if name == "amplitude_N":
        return error
    return error / amplitude_N * float(np.sqrt(12.0)) / (2.0 * np.pi * max(series.duration_s, 1e-9))


def _share(result: Search, place: int) -> Value:
    """Part of what the plays lag behind that depends on the bias, by rms over the recordings asked about.

    From what no plays and no curve follow up to all of it: how much of another hysteresis is congruent, nothing tells.
    """
    chain, found = result.chain, result.found
    bends = {name: x for name, x in found.point.values[place].items() if name.startswith(("degree_1", "curve"))}
    others = tuple(bends if number == place else values for number, values in enumerate(found.point.values))
    congruent = replace(found.point, values=others)
    shares = []
    for k, series in enumerate(chain.series):
        if series.role == "recording":
            rows = chain.rows[k]
            with_it, without_it = (chain.run(k, found.terms, point) for point in (found.point, congruent))
            added_V, columns = (with_it.stroke_V - without_it.stroke_V)[rows], with_it.columns[rows]
            curve = np.polynomial.chebyshev.chebvander(
                2.0 * series.command_V[rows] / chain.voltage_span_V - 1.0, DEGREES
            )
            followed = np.hstack((columns, curve))
            left_V = added_V - followed @ np.linalg.lstsq(followed, added_V, rcond=None)[0]
            lags_V = max(float(np.std(columns @ found.point.density)), 1e-12)
            shares.append((float(np.std(left_V)) / lags_V, float(np.std(added_V)) / lags_V))
    low, value = np.clip(np.mean(shares, axis=0), 0.0, 1.0).tolist()
    return Value(value, "1", low, 1.0)


def _rivals(result: Search, term: Term) -> tuple[Rival, ...]:
    """Other effects that came near, by how far they stay behind in noises: beside all that was found, or when tried.

    What was found besides is no rival, though it may have been one before both were found.
    """
    behind: dict[str, float] = {}
    for round_ in result.rounds:
        if round_.accepted.terms[-1].effect is term.effect:
            others = [one for one in round_.others if one.effects[-1] not in result.names]
            without_it = round_.before.loss
            losses = {
                one.effects[-1]: counted(one.effects[-1], without_it, one.loss)
                for one in sorted(others, key=_loss, reverse=True)
            }
            behind |= _near(without_it, counted(term.effect.name, without_it, round_.accepted.loss), losses)
    beside = result.beside.get(term.effect.name)
    if beside is not None:
        early = {name: loss for name, loss in behind.items() if name not in beside.rivals}
        behind = early | _near(beside.without, beside.with_it, beside.rivals)
    rivals = [Rival(name, float(np.sqrt(loss)), term.effect.separate_by) for name, loss in behind.items()]
    return tuple(sorted(rivals, key=lambda rival: rival.separation)[:3])


def _loss(one: Fitted) -> float:
    return one.loss


def _near(without_it: float, with_it: float, losses: Mapping[str, float]) -> dict[str, float]:
    """By how much the loss with others stays behind, where they gain nearly as much."""
    enough = without_it - RIVAL * (without_it - with_it)
    return {name: max(loss - with_it, 0.0) for name, loss in losses.items() if loss < enough}


def _confidence(gain: float, rivals: Sequence[Rival]) -> float:
    """From how much the loss falls and how near the closest rival comes."""
    nearest = min((rival.separation for rival in rivals), default=3.0)
    return float(np.clip(0.99 - 0.35 * np.exp(-gain / 0.1) - 0.4 * np.exp(-nearest / 0.15), 0.05, 0.99))


def read_off(
    series: Sequence[Series], frozen: Mapping[int, list[tuple[int, int]]], residuals: Sequence[Array], before: float
) -> list[Finding]:
    """What the readings show without a fit: frozen stretches, a coarse lattice."""
    found = []
    places = tuple(
        Place("time_s", series[k].start_s + a * series[k].dt_s, series[k].start_s + b * series[k].dt_s)
        for k, stretches in standing(series, frozen, residuals).items()
        for a, b in stretches
        if series[k].role == "recording"
    )
    if places:
        effect = EFFECTS["sensor_dropout"]
        parameters = {"from_s": places[0].low, "to_s": places[0].high}
        values = {name: Value(value, "s", value, value) for name, value in parameters.items()}
        found.append(
            Finding(
                effect.name, effect.title, 0.97, "once", places, values, before, before, (), effect.handling, effect.why
            )
        )
    step, rest = _coarsest(series, residuals)
    if step > 0.0 and step / np.sqrt(12.0) > COARSE * rest:
        effect = EFFECTS["quantisation"]
        values = {"step_N": Value(step, "N", 0.99 * step, 1.01 * step)}
        found.append(
            Finding(
                effect.name, effect.title, 0.95, "since", (), values, before, before, (), effect.handling, effect.why
            )
        )
    return found


def standing(
    series: Sequence[Series], frozen: Mapping[int, list[tuple[int, int]]], residuals: Sequence[Array]
) -> dict[int, list[tuple[int, int]]]:
    """Those stretches of readings that stand still which what was found leaves standing, by the number of the series.

    Parameters
    ----------
    series, residuals
        Recordings, and what was found leaves of each, shape (N,) [N].
    frozen
        First sample and end of each stretch.
    """
    return {
        k: [one for one in stretches if _stands(series[k], residuals[k], slice(*one))]
        for k, stretches in frozen.items()
    }


def _stands(series: Series, residual: Array, stretch: slice) -> bool:
    """Whether a reading stands still to the last bit, or unlike the model with all that was found.

    Behind a delay that was not known at first, a reading seems to stand still at each edge of the command.
    """
    exactly = np.ptp(series.reading_N[stretch]) == 0.0
    noise_N = max(series.noise_N, series.lattice_N)
    return bool(exactly or np.sqrt(np.mean(residual[stretch] ** 2)) > UNLIKE * noise_N)


def _coarsest(series: Sequence[Series], residuals: Sequence[Array]) -> tuple[float, float]:
    """The coarsest lattice among the recordings asked about, and the noise besides it."""
    steps = [(one.lattice_N, k) for k, one in enumerate(series) if one.role == "recording"]
    step, k = max(steps)
    spread = float(np.std(residuals[k][series[k].counts]))
    return step, float(np.sqrt(max(spread**2 - step**2 / 12.0, 0.0)))
