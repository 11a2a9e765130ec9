"""How long a command was held before its reading, where the recordings say so: a delay, a lag and that look alike."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import SAME
from piezod.diagnose.selection.acceptance import worth
from piezod.diagnose.selection.search import without
from piezod.effects import EFFECTS

BESIDE = 1e-3  # of a sample: either side of a held command's step


def as_told(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """A hypothesis on the course that the recordings tell of, a delay in it where it needs one there.

    The search takes the course that fits best, and on another one part of a sample may pass for a delay, for the lack
    of one, or for a lag. It stays as it is where the recordings do not say, or nothing fits there as well.
    """
    told = {one.recorded_hold for one in chain.series if one.role == "recording"}
    hold, fitted_hold = told.pop(), chain.series[-1].hold
    if told or hold is None:
        return chain, fitted
    series = [one if one.recorded_hold is None else replace(one, hold=hold) for one in chain.series]
    later_s = (hold.read_after - fitted_hold.read_after) * chain.series[-1].dt_s
    place = next((k for k, term in enumerate(fitted.terms) if term.effect.name == "transport_delay"), None)
    if place is None:
        again = None if fitted_hold == hold else _made_late(chain.like(series), fitted, later_s)
    elif fitted.terms[place].scope == "already" and any(one.recorded_hold is None for one in series):
        again = None
    else:
        again = _delayed(chain.like(series), fitted.terms, fitted.point, place, later_s)
    return (chain, fitted) if again is None or not _as_good(again, fitted) else (chain.like(series), again)


def _made_late(chain: Chain, fitted: Fitted, later_s: float) -> Fitted | None:
    """A hypothesis with a delay besides, and without the lags that were a part of it; None where nothing is late."""
    plain = fit(chain, fitted.terms, fitted.point)
    if _as_good(plain, fitted):
        return None
    told = all(one.recorded_hold is not None for one in chain.series)
    terms = (*fitted.terms, Term(EFFECTS["transport_delay"], "already" if told else "since"))
    values = (*fitted.point.values, {"delay_s": 0.0})
    late = _delayed(chain, terms, replace(fitted.point, values=values), len(terms) - 1, later_s)
    return _without_its_parts(chain, late) if _as_good(late, fitted) and worth(plain, late) else None


def _delayed(chain: Chain, terms: Sequence[Term], point: Point, place: int, later_s: float) -> Fitted:
    """Fitted from either side of where a held command's step is read."""
    parameter = terms[place].effect.parameter("delay_s")
    tried = []
    for beside in (-BESIDE, BESIDE):
        values = [dict(one) for one in point.values]
        delay_s = values[place]["delay_s"] + later_s + beside * chain.series[-1].dt_s
        values[place]["delay_s"] = float(np.clip(delay_s, parameter.low, parameter.high))
        tried.append(fit(chain, terms, replace(point, values=tuple(values))))
    return min(tried, key=lambda one: one.loss)


def _without_its_parts(chain: Chain, found: Fitted) -> Fitted:
    """Without the lags that the delay makes needless."""
    for name in [term.effect.name for term in found.terms if term.effect.smooths]:
        terms, values = without(found, name)
        place = next(k for k, term in enumerate(terms) if term.effect.name == "transport_delay")
        later_s = _lag_s(found, name)
        fewer = _delayed(chain, terms, replace(found.point, values=tuple(values)), place, later_s)
        if _as_good(fewer, found):
            found = fewer
    return found


def _lag_s(found: Fitted, name: str) -> float:
    """By how much an effect that smooths makes late what is slow."""
    values = next(v for term, v in zip(found.terms, found.point.values, strict=True) if term.effect.name == name)
    if "cutoff_Hz" in values:
        return 1.0 / (2.0 * np.pi * values["cutoff_Hz"])
    return values.get("time_constant_s", 0.0)


def _as_good(one: Fitted, other: Fitted) -> bool:
    return one.loss <= (1.0 + SAME) * other.loss
