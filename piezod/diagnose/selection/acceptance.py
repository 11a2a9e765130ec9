"""Whether one more effect is accepted: its gain, how steady the gain is, and whether its values suit its name."""

import math
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.steps import JUMP_S, Step, has_clear_edges, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.record import record_of
from piezod.diagnose.rules import RULES
from piezod.effects import EFFECTS

SMALLEST_CHANGE, FEWEST_BLOCKS = 1e-3, 4  # blocks whose logarithmic loss changes, and how many a steadiness needs


def loss_by_choices(fitted: Fitted) -> float:
    """Loss by which the choices of an effect are compared; one that is not the first of its parameter must gain."""
    first = [(p.name, p.search.choices[0]) for term in fitted.terms for p in term.effect.parameters if p.search.choices]
    chosen = [choice for term in fitted.terms for choice in term.choices]
    return float(fitted.loss / RULES.better ** sum(choice not in first for choice in chosen))


def worth(before: Fitted, after: Fitted) -> bool:
    """Whether an effect gains enough on blocks left out: the steadier it gains in them, the less it must gain."""
    before, after = comparable(before, after)
    return before.loss - after.loss > least_gain(steadiness(before, after)) * after.loss


def steady_enough(before: Fitted, after: Fitted) -> bool:
    """Whether the last effect has a shape of its own, or gains in most blocks."""
    return not after.terms[-1].effect.flexible or steadiness(*comparable(before, after)) > RULES.steady


def accepted(chain: Chain, before: Fitted, after: Fitted) -> bool:
    """Whether the last effect has plausible values, and gains enough and steadily enough."""
    return not degenerate(chain, after) and worth(before, after) and steady_enough(before, after)


def comparable(before: Fitted, after: Fitted) -> tuple[Fitted, Fitted]:
    """Both hypotheses; a block that neither predicts from the others counts with its loss in the fit."""
    isolated = (before.losses > RULES.isolated * before.in_fit) & (after.losses > RULES.isolated * after.in_fit)
    first, second = (replace(fit, losses=np.where(isolated, fit.in_fit, fit.losses)) for fit in (before, after))
    return first, second


def least_gain(steady: float, worth: float = RULES.worth, steadily: float = RULES.steadily) -> float:
    """Least gain of an effect, relative to the loss that it leaves.

    Parameters
    ----------
    worth, steadily
        Least gain without steadiness, and the steadiness that lowers it to 1 / e.
    """
    return worth * math.exp(-steady / steadily)


def highest_accepted_loss(before: Fitted) -> float:
    """Loss above which no further effect is accepted: that of one that gains equally in every block."""
    blocks = int(np.count_nonzero(before.samples > 0))
    return before.loss / (1.0 + least_gain(math.sqrt(blocks)))


def penalised_loss(fitted: Fitted) -> float:
    """Loss with the price of the last effect's parameters."""
    priced = min(len(fitted.terms[-1].searched), RULES.most_priced)
    return fitted.loss * (1.0 + RULES.parameter_price * priced)


def comparison_loss(name: str, without_it: float, with_it: float) -> float:
    """Loss by which an effect is compared with its rivals; that of a general effect is raised."""
    if not EFFECTS[name].general:
        return with_it
    price = RULES.general_price * max(without_it - with_it, 0.0)
    return with_it + min(price, RULES.most_general * with_it)


def steadiness(before: Fitted, after: Fitted) -> float:
    """Sum of the blocks' logarithmic gains, over its standard deviation for random signs."""
    counts = (before.samples > 0) & (after.samples > 0)
    gains = np.log(before.losses[counts] / after.losses[counts])
    gains = gains[np.abs(gains) > SMALLEST_CHANGE]
    if gains.size < FEWEST_BLOCKS:
        return 0.0
    largest = RULES.largest_share * float(np.median(np.abs(gains)))
    gains = np.clip(gains, -largest, largest)
    return float(np.sum(gains)) / float(np.sqrt(np.sum(gains**2)))


def degenerate(chain: Chain, fitted: Fitted) -> bool:
    """Whether the values of the last effect do not suit its name.

    A step without edges is a drift. A step at the begin is what an unknown start leaves.
    """
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if not term.effect.plausible(values, record_of(term, chain)):
        return True
    return any(parameter.instant for parameter in term.effect.parameters) and not _is_a_step(chain, fitted)


def _is_a_step(chain: Chain, fitted: Fitted) -> bool:
    """Whether the last effect, a step, has edges, and is none that an unknown start may leave.

    Such a step ends or begins for good soon after the start, or where the command leaves the range swept before.
    """
    term, values = fitted.terms[-1], fitted.point.values[-1]
    series = chain.series[term.series]
    size, begin = series.time_s.size, RULES.edge * series.time_s.size
    late_s = shown_late_s(chain, fitted.terms, fitted.point)
    first, end = (round((values[name] + late_s) / series.dt_s) for name in ("on_s", "off_s"))
    if end <= begin or (end >= size and first < begin):
        return False
    near = round(JUMP_S / series.dt_s)
    of_past = [series.start_columns[max(edge - near, 0) : edge + near] for edge in (first, end) if edge < size]
    if any(columns.size and np.ptp(columns, axis=0).any() for columns in of_past):
        return False
    residual_N = series.reading_N - chain.run(term.series, fitted.terms, fitted.point).reading_N
    return has_clear_edges(series, residual_N, Step(values["step_N"], first, min(end, size)))
