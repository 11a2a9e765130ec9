"""Evidence for each effect: parameters with intervals, errors without and with it, rivals, confidence."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.findings import Base, Finding, Place, Rival, Status, UnchangedEffect, Value
from piezod.diagnose.hypothesis.left_out import FORM_ERROR, INTERVAL_FACTOR
from piezod.diagnose.hypothesis.record import place_of
from piezod.diagnose.hypothesis.stack_change import NAMES
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import comparison_loss
from piezod.diagnose.selection.given_effects import as_given, refitted_without
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.significance import p_value
from piezod.diagnose.verdict.verdict import held_out_rms
from piezod.effects import EFFECTS, Parameter
from piezod.effects.effect import Effect
from piezod.effects.noncongruent_minor_loops import DEGREES, shown_by
from piezod.estimation.recordings.series import Series
from piezod.model import Model
from piezod.model.information import Information

RIVAL_GAIN = 0.8  # least gain of a rival, as a share of the gain of the accepted effect
NORMAL_95 = 1.96  # half of a 95 % interval [standard errors]
WIDEST_SPREAD = 20.0  # largest half interval on the search scale; beyond it the parameter is undetermined
LAG_ERROR = 1.0 / 8.0  # largest error of a sub-sample delay beside a lag [samples]: f (1 - f) / 2 for its fraction f
AT_NOISE = 1.5
"""Mean square [noise variance] up to which minor loops explain all. Those of the emulated bench leave 1.2; a pneumatic
actuator and a damper, which have none, leave 18 and 1,000."""
NO_RIVAL = 3.0  # separation assumed if there is no rival [noise rms]


def finding_of(result: Search, name: str, given: Model | None = None) -> Finding:
    """Finding about a fitted effect: parameters, and errors on left-out blocks without and with it.

    The first error of a changed effect is that with its old values.
    """
    chain, fitted = result.chain, result.hypothesis
    place = next(k for k, term in enumerate(fitted.terms) if term.effect.name == name)
    term, values = fitted.terms[place], fitted.point.values[place]
    if name in result.given:
        reduced = as_given(chain, fitted, result.base, name)
    else:
        reduced = refitted_without(chain, fitted, name) if len(fitted.effects) > 1 else result.base
    rivals = _rivals(result, term)
    finding = finding_about(
        term.effect,
        confidence_of(float(np.log(reduced.loss / fitted.loss)), rivals),
        term.scope,
        place_of(term, values, chain),
        _parameters(result, place),
        (held_out_rms(chain, reduced), held_out_rms(chain, fitted)),
    )
    status: Status = "changed" if name in result.given else "new"
    was = {} if given is None or name not in result.given else given_values(given, name)
    return replace(finding, rivals=rivals, p=p_value(result, reduced, name), status=status, was=was)


def finding_about(
    effect: Effect,
    confidence: float,
    scope: str,
    places: tuple[Place, ...],
    parameters: dict[str, Value],
    errors: tuple[float, float],
) -> Finding:
    """Finding about an effect of the catalogue; `errors`: before and after."""
    name, title, handling, why = effect.name, effect.title, effect.handling, effect.why
    return Finding(name, title, confidence, scope, places, parameters, *errors, handling=handling, why=why)


def _parameters(result: Search, place: int) -> dict[str, Value]:
    """Parameters of the fitted effect at this place with their intervals; without instants after the last sample."""
    chain, fitted = result.chain, result.hypothesis
    term, values = fitted.terms[place], fitted.point.values[place]
    series, systematic = chain.series[term.series], result.systematic[place]
    parameters = {}
    for parameter in term.effect.catalogued:
        value = {**values, **dict(term.choices)}[parameter.name]
        error = min(NORMAL_95 * fitted.spread[place].get(parameter.name, 0.0), WIDEST_SPREAD)
        in_fit = _ends(parameter, value, error)
        if parameter.instant and value > series.duration_s:
            continue
        begin_s = series.start_s if parameter.instant else 0.0
        error = systematic.get(parameter.name, 0.0)
        low, high = in_fit if parameter.instant else widened(parameter, value, in_fit, error)
        parameters[parameter.name] = Value(begin_s + value, parameter.unit, begin_s + low, begin_s + high, in_fit)
    if term.effect.is_delay:
        smoothed = any(other.effect.smooths for other in fitted.terms)
        parameters["delay_s"] = _with_hold_error(parameters["delay_s"], chain.series[-1], smoothed=smoothed)
    if term.effect.weights:
        parameters["share"] = _noncongruent_share(result, place)
    return parameters


def _ends(parameter: Parameter, value: float, error: float) -> tuple[float, float]:
    """Ends of an interval of half width `error` on the search scale, within the range of the parameter."""
    if parameter.search.logarithmic:
        ends = value * np.exp(-error), value * np.exp(error)
    else:
        ends = value - error, value + error
    return float(max(ends[0], parameter.low)), float(min(ends[1], parameter.high))


def widened(parameter: Parameter, value: float, in_fit: tuple[float, float], systematic: float) -> tuple[float, float]:
    """Interval of the fit (`in_fit`), widened by the errors that left-out blocks do not show.

    These are the form of the effect, and `systematic` of `systematic_errors`. The latter never change the sign.
    """
    low, high = (
        value + side * np.hypot(INTERVAL_FACTOR * (end - value), FORM_ERROR * value)
        for side, end in zip((-1, 1), in_fit, strict=True)
    )
    if parameter.low >= 0.0:
        low = min(max(low, value**2 / high), in_fit[0])  # the factor below is at most the factor above
    low, high = _with_systematic(parameter, value, (low, high), min(systematic, WIDEST_SPREAD))
    return float(max(low, parameter.low)), float(min(high, parameter.high))


def _with_systematic(
    parameter: Parameter, value: float, ends: tuple[float, float], systematic: float
) -> tuple[float, float]:
    """Interval with a further error on the search scale, added in squares."""
    if parameter.search.logarithmic:
        below, above = -value * np.expm1(-systematic), value * np.expm1(systematic)
    else:
        below = above = systematic
    low, high = value - np.hypot(value - ends[0], below), value + np.hypot(ends[1] - value, above)
    if ends[0] > 0.0:
        return max(low, value * ends[0] / high), high
    if ends[1] < 0.0:
        return low, min(high, value * ends[1] / low)
    return low, high


def gone_finding(result: Search, name: str, given: Model) -> Finding:
    """Finding about an effect of the given model that the recordings do not show.

    Its errors on left-out blocks are with and without it, its parameters are the values of the given model.
    """
    chain, fitted = result.chain, result.hypothesis
    full = as_given(chain, fitted, result.base, name)
    effect, was = EFFECTS[name], given_values(given, name)
    finding = finding_about(
        effect,
        confidence_of(float(np.log(full.loss / fitted.loss)), ()),
        next(term.scope for term in result.base.terms if term.effect.name == effect.name),
        (),
        was,
        (held_out_rms(chain, full), held_out_rms(chain, fitted)),
    )
    return replace(finding, p=p_value(result, full, name), status="gone", was=was)


def _relative_errors(known: Information | None) -> dict[str, float]:
    """Half 95 % intervals of the given model's gain and loop width [1]; a change is relative to these."""
    if known is None:
        return {}
    intervals = zip(NAMES, (known.gain, known.loop_width_percent), strict=True)
    return {name: (high - low) / max(abs(high + low), 1e-300) for name, (low, high) in intervals}


def base_of(result: Search) -> Base:
    """Change of the stack itself: gain and width of the loops, with the errors of both estimates."""
    if not result.stack_changed:
        return Base()
    chain, fitted = result.stack or (result.chain, result.hypothesis)
    values, reduced, before = {}, fitted, _relative_errors(result.known)
    for name in NAMES:
        place = next((k for k, term in enumerate(fitted.terms) if term.effect.name == name), None)
        if place is not None:
            reduced = refitted_without(chain, reduced, name)
            value, spread = fitted.point.values[place][name], fitted.spread[place].get(name, 0.0)
            error = float(np.hypot(INTERVAL_FACTOR * NORMAL_95 * spread, before.get(name, 0.0)))
            values[name] = Value(value, "1", value * float(np.exp(-error)), value * float(np.exp(error)))
    commands_V = [series.command_V for series in chain.series if series.role == "recording"]
    low_V, high_V = min(float(u.min()) for u in commands_V), max(float(u.max()) for u in commands_V)
    place_V = Place("voltage_V", low_V, high_V)
    confidence = confidence_of(float(np.log(reduced.loss / fitted.loss)), ())
    return Base(True, values.get("gain"), values.get("loops"), (place_V,), confidence)


def given_values(given: Model, name: str) -> dict[str, Value]:
    """Parameters of an effect of the given model; an interval that the model does not state is the value itself."""
    entry = next(effect for effect in given.effects if effect.name == name)
    values = {}
    for parameter in EFFECTS[name].catalogued:
        value = entry.parameters.get(parameter.name, parameter.search.starts[0] if parameter.search.starts else 0.0)
        low, high = (entry.intervals or {}).get(parameter.name, (value, value))
        values[parameter.name] = Value(value, parameter.unit, low, high)
    return values


def unchanged_effects(
    result: Search, given: Model, written: Model, findings: Sequence[Finding], tones: Sequence[str]
) -> list[UnchangedEffect]:
    """Effects of the given model that have not changed, including effects of other recordings.

    `findings`: new, changed and gone effects; `tones`: names of unchanged tones. `written` may have joint estimates.
    """
    different = {finding.name for finding in findings}
    names = [name for name in dict.fromkeys(effect.name for effect in given.effects) if name not in different]
    seen = {name for name, status in result.statuses.items() if status == "kept"} | set(tones)
    in_written = {effect.name for effect in written.effects}
    models = {name: written if name in in_written else given for name in names}
    return [UnchangedEffect(name, given_values(models[name], name), name in seen) for name in names]


def _with_hold_error(delay_s: Value, series: Series, *, smoothed: bool) -> Value:
    """Delay with its interval widened by two unknown fractions of a sample.

    If the recording does not state its hold, the time from the command to the reading is unknown. If the command is
    held, the delay is unknown within a sample; behind a lag (`smoothed`) only within `LAG_ERROR`.
    """
    stated, held = series.hold == series.recorded_hold, not series.hold.straight
    within_s = (LAG_ERROR if smoothed else 1.0) * series.dt_s if held else 0.0
    read_after = series.hold.read_after
    shorter_s, longer_s = (0.0, 0.0) if stated else (read_after * series.dt_s, (1.0 - read_after) * series.dt_s)
    return replace(delay_s, low=max(delay_s.low - shorter_s - within_s, 0.0), high=delay_s.high + longer_s + within_s)


def _noncongruent_share(result: Search, place: int) -> Value:
    """Rms of the stroke that depends on the bias over the rms of the plays, in the diagnosed recordings [1].

    Lower end: the part that neither plays nor a curve of the command follow. Upper end: 1, since the congruent share of
    an unknown hysteresis is unknown. The interval of the fit is that of the lower end. It needs alike loops at
    different biases, a fit that reaches the noise, and a part that is large enough to be an effect.
    """
    chain, fitted = result.chain, result.hypothesis
    congruent_values = {
        name: x for name, x in fitted.point.values[place].items() if name.startswith(("degree_1", "curve"))
    }
    others = tuple(congruent_values if k == place else values for k, values in enumerate(fitted.point.values))
    congruent = replace(fitted.point, values=others)
    shares, needed, errors = [], [], []
    for k, series in enumerate(chain.series):
        if series.role == "recording":
            rows = chain.rows[k]
            full, reduced = (chain.run(k, fitted.terms, point) for point in (fitted.point, congruent))
            added_V, plays_V = (full.stroke_V - reduced.stroke_V)[rows], full.columns[rows]
            scaled = 2.0 * series.command_V[rows] / chain.voltage_span_V - 1.0
            columns = np.hstack((plays_V, np.polynomial.chebyshev.chebvander(scaled, DEGREES)))
            unfollowed_V = added_V - columns @ np.linalg.lstsq(columns, added_V, rcond=None)[0]
            lags_V = max(float(np.std(plays_V @ fitted.point.density)), 1e-12)
            shares.append((float(np.std(unfollowed_V)) / lags_V, float(np.std(added_V)) / lags_V))
            gain = float(np.std(full.reading_N) / np.std(full.stroke_V))
            noise_V = np.sqrt(fitted.loss) * series.noise_N / gain
            needed.append(shown_by(series.command_V) and float(np.var(unfollowed_V)) > RULES.worth * noise_V**2)
            errors.append(noise_V / lags_V * np.sqrt(len(fitted.terms[place].weights) / unfollowed_V.size))
    low, value = np.clip(np.mean(shares, axis=0), 0.0, 1.0).tolist()
    if fitted.loss > AT_NOISE or not any(needed):
        return Value(value, "1", low, 1.0)
    error = NORMAL_95 * float(np.mean(errors))
    return Value(value, "1", low, 1.0, (max(low - error, 0.0), min(low + error, 1.0)))


def _rivals(result: Search, term: Term) -> tuple[Rival, ...]:
    """The three closest rivals of an effect, with their separation [noise rms].

    Rivals in place of the effect in the final hypothesis count before rivals in the round that accepted it. An effect
    that was found itself is no rival.
    """
    behind: dict[str, float] = {}
    for round_ in result.rounds:
        if round_.accepted.effects[-1] == term.effect.name:
            others = [other for other in round_.others if other.effects[-1] not in result.names]
            without = round_.before.loss
            losses = {
                other.effects[-1]: comparison_loss(other.effects[-1], without, other.loss)
                for other in sorted(others, key=lambda fitted: fitted.loss, reverse=True)
            }
            accepted = comparison_loss(term.effect.name, without, round_.accepted.loss)
            behind |= _excess_losses(without, accepted, losses)
    final = result.rivalries.get(term.effect.name)
    if final is not None:
        early = {name: loss for name, loss in behind.items() if name not in final.rivals}
        behind = early | _excess_losses(final.without, final.with_effect, final.rivals)
    rivals = [Rival(name, float(np.sqrt(loss)), term.effect.separate_by) for name, loss in behind.items()]
    return tuple(sorted(rivals, key=lambda rival: rival.separation)[:3])


def _excess_losses(without: float, with_effect: float, losses: Mapping[str, float]) -> dict[str, float]:
    """Losses above `with_effect` of rivals that gain nearly as much, by name."""
    limit = without - RIVAL_GAIN * (without - with_effect)
    return {name: max(loss - with_effect, 0.0) for name, loss in losses.items() if loss < limit}


def confidence_of(gain: float, rivals: Sequence[Rival]) -> float:
    """Confidence from the logarithmic fall of the loss and the separation of the closest rival.

    It estimates the share of such findings that are right in concealed cases.
    """
    nearest = min((rival.separation for rival in rivals), default=NO_RIVAL)
    return float(np.clip(0.99 - 0.35 * np.exp(-gain / 0.1) - 0.4 * np.exp(-nearest / 0.15), 0.05, 0.99))
