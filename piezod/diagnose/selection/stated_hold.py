"""Refit with the hold that the recordings state; a fitted hold may pass for a delay or a lag."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import EQUAL
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.selection.acceptance import worth
from piezod.diagnose.selection.given_effects import without
from piezod.effects import EFFECTS

DELAY = next(effect for effect in EFFECTS.values() if effect.is_delay)
STEP_MARGIN = 1e-3  # distance of the starts from the step of a held command [samples]


def with_stated_hold(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """Hypothesis with the stated hold, and with a delay if it needs one there.

    The hypothesis stays if the recordings state no common hold, or if nothing fits as well with it.
    """
    stated = {series.recorded_hold for series in chain.series if series.role == "recording"}
    hold, fitted_hold = stated.pop(), chain.series[-1].hold
    if stated or hold is None:
        return chain, fitted
    series = [s if s.recorded_hold is None else replace(s, hold=hold) for s in chain.series]
    later_s = (hold.read_after - fitted_hold.read_after) * chain.series[-1].dt_s
    place = next((k for k, term in enumerate(fitted.terms) if term.effect.is_delay), None)
    if place is None:
        refitted = None if fitted_hold == hold else _with_new_delay(chain.like(series), fitted, later_s)
    elif fitted.terms[place].scope == "already" and any(s.recorded_hold is None for s in series):
        refitted = None
    else:
        refitted = _with_delay_near(chain.like(series), fitted.terms, fitted.point, place, later_s)
    if refitted is None or not _fits_as_well(refitted, fitted):
        return chain, fitted
    return chain.like(series), refitted


def _with_new_delay(chain: Chain, fitted: Fitted, later_s: float) -> Fitted | None:
    """Hypothesis with a delay, without lags that imitated it; None if no delay is needed or it does not fit."""
    plain = fit(chain, fitted.terms, fitted.point)
    if _fits_as_well(plain, fitted):
        return None
    all_stated = all(series.recorded_hold is not None for series in chain.series)
    terms = (*fitted.terms, Term(DELAY, "already" if all_stated else "since"))
    values = (*fitted.point.values, {"delay_s": 0.0})
    delayed = _with_delay_near(chain, terms, replace(fitted.point, values=values), len(terms) - 1, later_s)
    return _without_lags(chain, delayed) if _fits_as_well(delayed, fitted) and worth(plain, delayed) else None


def _with_delay_near(chain: Chain, terms: Sequence[Term], point: Point, place: int, later_s: float) -> Fitted:
    """Fit from both sides of a delay that is `later_s` longer, where the step of a held command is read."""
    parameter = terms[place].effect.parameter("delay_s")
    tried = []
    for margin in (-STEP_MARGIN, STEP_MARGIN):
        values = [dict(known) for known in point.values]
        delay_s = values[place]["delay_s"] + later_s + margin * chain.series[-1].dt_s
        values[place]["delay_s"] = float(np.clip(delay_s, parameter.low, parameter.high))
        tried.append(fit(chain, terms, replace(point, values=tuple(values))))
    return min(tried, key=lambda hypothesis: hypothesis.loss)


def _without_lags(chain: Chain, fitted: Fitted) -> Fitted:
    """Hypothesis without the lags that the delay makes redundant."""
    for name in [term.effect.name for term in fitted.terms if term.effect.smooths]:
        terms, values = without(fitted, name)
        place = next(k for k, term in enumerate(terms) if term.effect.is_delay)
        point = replace(fitted.point, values=tuple(values))
        reduced = _with_delay_near(chain, terms, point, place, _lag_s(fitted, name))
        if _fits_as_well(reduced, fitted):
            fitted = reduced
    return fitted


def _lag_s(fitted: Fitted, name: str) -> float:
    """Delay of slow signals by an effect that smooths [s]."""
    values = next(v for term, v in zip(fitted.terms, fitted.point.values, strict=True) if term.effect.name == name)
    if "cutoff_Hz" in values:
        return 1.0 / (2.0 * np.pi * values["cutoff_Hz"])
    return values.get("time_constant_s", 0.0)


def _fits_as_well(hypothesis: Fitted, other: Fitted) -> bool:
    return hypothesis.loss <= (1.0 + EQUAL) * other.loss
