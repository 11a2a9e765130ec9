"""Errors of fitted parameters that are alike in all blocks, so that left-out blocks do not show them.

The form of an effect differs from the plant. Such a difference moves a parameter by FORM c / sqrt(m)
(derived here). c is the root of the summed squares of all contributions [noise rms]. m is the information on the
parameter if all others are unknown, so a parameter that others nearly replace has a large error.

The time from a command to its reading is unknown within a sample if the recording does not state its hold. Lags and
couplings follow that time. A time that fits nearly as well is as likely.
"""

from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal
from piezod.diagnose.hypothesis.sampling import EQUAL
from piezod.estimation.fit.blocks import solved

FORM = 0.005
"""Half of a 95 % interval of the wrong share of the contributions, along the signal of one parameter. Of 136 parameters
of 88 concealed benches, fitted with the true effects, 85 % lay in the intervals without these errors, and 93 % in those
with them (0.003: 89 %). The median half interval grew from 1.9 to 4.2 % of the value."""
TIME = 1.0 / float(np.sqrt(12.0))  # standard error of a time that is uniform within a sample [samples]
HALF_95 = 1.96  # half of a 95 % interval [standard errors]


def systematic_errors(chain: Chain, fitted: Fitted) -> tuple[dict[str, float], ...]:
    """Half 95 % intervals by form and time of each term's parameters, on the scale that is fitted.

    The values of held effects have errors too, so their parameters count as unknown.
    """
    normal = Normal.at(chain, [replace(term, held=False) for term in fitted.terms], fitted.point)
    layout = normal.layout
    hessian = normal.total[0] + layout.prior(chain, fitted.point)
    variances = np.maximum(np.diag(solved(hessian, np.eye(layout.size))), 0.0)
    form = FORM * np.sqrt(_contributions(normal) * variances)
    errors = np.hypot(form, HALF_95 * np.abs(_shifts_by_time(normal, hessian)))
    result: tuple[dict[str, float], ...] = tuple({} for _ in fitted.terms)
    for place, (term, parameter) in enumerate(layout.searched, start=layout.effects):
        result[term][parameter.name] = float(errors[place])
    return result


def _contributions(normal: Normal) -> float:
    """Sum of the squares of each effect's contribution to the compared readings [noise variance]."""
    square = 0.0
    for place in range(len(normal.terms)):
        terms = [term for k, term in enumerate(normal.terms) if k != place]
        values = tuple(known for k, known in enumerate(normal.point.values) if k != place)
        point = replace(normal.point, values=values)
        for number, series in enumerate(normal.chain.series):
            added = normal.compared[number] - normal.chain.compared(number, terms, point)
            square += float(np.sum((added * normal.trust[number] / series.noise_N) ** 2))
    return square


def _shifts_by_time(normal: Normal, hessian: Array) -> Array:
    """Change of the fitted vector with one standard error of the time of the readings, shape (P,).

    A fitted delay is kept, since the recordings show only the sum of time and delay.
    """
    kept = [normal.terms[term].effect.is_delay for term, _ in normal.layout.searched]
    held = np.array([np.nan] * normal.layout.effects + [0.0 if one else np.nan for one in kept])
    slopes, dt_s = [], 0.0
    for number, series in enumerate(normal.chain.series):
        slope = np.zeros(series.time_s.size)
        if series.role == "recording" and series.hold != series.recorded_hold:
            slope = np.gradient(normal.chain.run(number, normal.terms, normal.point).reading_N, series.dt_s)
            dt_s = max(dt_s, series.dt_s)
        slopes.append(slope[normal.chain.rows[number], None])
    if dt_s == 0.0:
        return np.zeros(hessian.shape[0])
    sums, _ = normal.beside(slopes)
    along, square = sums.total[1][:, 0], float(sums.square[:, 0, 0].sum())
    per_second = solved(hessian, along, held)
    information = max(square - float(along @ per_second), 0.0)
    tolerance = EQUAL * float(normal.blocks.square.sum())  # of the sum of squares, as in the choice of a hold
    shifts: Array = per_second / np.sqrt((TIME * dt_s) ** -2.0 + information / max(tolerance, 1e-300))
    return shifts
