"""Acceptance of one more effect: its gain, the steadiness of the gain, and the plausibility of its parameters."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.steps import Step, has_clear_edges, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.record import record_of
from piezod.effects import EFFECTS

Array = NDArray[np.float64]

WORTH, STEADILY = 0.22, 5.0
"""An effect must gain WORTH exp(-steadiness / STEADILY) of the loss with it. Both were chosen on 921 decisions in
422 replay files of four families; with each family left out the choice is equal (`python -m tests.studies rules`)."""

STEADY = 3.0  # least steadiness of a flexible effect; on these files it excludes 5 of 25 false effects and no true one
BETTER = 0.98  # largest loss ratio at which a hypothesis is preferred to another
ISOLATED = 10.0  # loss over that within the fit above which no other block predicts a block; 0.1 % of blocks exceed it
MOST_OF_A_BLOCK = 3.0  # upper limit of a block's gain, in median gains
BEGIN = 0.02  # first share of a recording, in which an unknown initial state resembles a step
PARAMETER_COST = 0.01  # relative penalty per parameter that shapes the last effect
MOST_PARAMETERS = 8  # largest number of penalised parameters: of many stiff ones few are effective
GAIN_MARGIN, LOSS_MARGIN = 0.1, 0.5
"""A general effect must beat a specific rival by 10 % of its gain, at most 50 % of its loss."""


def worth(before: Fitted, after: Fitted) -> bool:
    """Whether an effect gains enough on left-out blocks; a steady gain may be smaller."""
    before, after = comparable(before, after)
    return before.loss - after.loss > least_gain(steadiness(before, after)) * after.loss


def steady_enough(before: Fitted, after: Fitted) -> bool:
    """Whether the last effect is specific, or a flexible one with a steady gain."""
    return not after.terms[-1].effect.flexible or steadiness(*comparable(before, after)) > STEADY


def comparable(before: Fitted, after: Fitted) -> tuple[Fitted, Fitted]:
    """Both hypotheses with the loss within the fit for each block that no other block predicts."""
    isolated = (before.losses > ISOLATED * before.in_fit) & (after.losses > ISOLATED * after.in_fit)
    first, second = (replace(h, losses=np.where(isolated, h.in_fit, h.losses)) for h in (before, after))
    return first, second


def least_gain(steady: float, worth: float = WORTH, steadily: float = STEADILY) -> float:
    """Least gain of an effect, relative to the loss with it.

    `steady`: steadiness; `worth`: least gain at steadiness 0; `steadily`: steadiness that lowers it by 1 / e.
    """
    return worth * math.exp(-steady / steadily)


def penalised_loss(fitted: Fitted) -> float:
    """Loss with a penalty for every parameter of the last effect: of two equal hypotheses the simpler one wins."""
    return fitted.loss * (1.0 + PARAMETER_COST * min(len(fitted.terms[-1].searched), MOST_PARAMETERS))


def comparison_loss(name: str, without: float, with_effect: float) -> float:
    """Loss for the comparison of an effect with its rivals, from the losses without and with it.

    A general effect gets a margin, since it fits many residuals.
    """
    if not EFFECTS[name].general:
        return with_effect
    return with_effect + min(GAIN_MARGIN * max(without - with_effect, 0.0), LOSS_MARGIN * with_effect)


def steadiness(before: Fitted, after: Fitted) -> float:
    """Sum of the logarithmic gains of the blocks, over its standard deviation for random signs.

    The gain of a single block is limited, so that it does not outweigh all others.
    """
    counted = (before.samples > 0) & (after.samples > 0)
    gains = np.log(before.losses[counted] / after.losses[counted])
    affected = gains[np.abs(gains) > 1e-3]
    if affected.size < 4:
        return 0.0
    most = MOST_OF_A_BLOCK * float(np.median(np.abs(affected)))
    affected = np.clip(affected, -most, most)
    return float(np.sum(affected)) / float(np.sqrt(np.sum(affected**2)))


def degenerate(chain: Chain, fitted: Fitted) -> bool:
    """Whether the parameters of the last effect are implausible, or a step has no clear edges."""
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if not term.effect.plausible(values, record_of(term, chain)):
        return True
    return any(parameter.instant for parameter in term.effect.parameters) and not _is_a_step(chain, fitted)


def _is_a_step(chain: Chain, fitted: Fitted) -> bool:
    """Whether the last effect, a step, has clear edges after the begin of the recording."""
    term, values = fitted.terms[-1], fitted.point.values[-1]
    series = chain.series[term.series]
    size, begin = series.time_s.size, BEGIN * series.time_s.size
    late_s = shown_late_s(chain, fitted.terms, fitted.point)
    first, end = (round((values[name] + late_s) / series.dt_s) for name in ("on_s", "off_s"))
    if end <= begin or (end >= size and first < begin):
        return False
    residual_N = series.reading_N - chain.run(term.series, fitted.terms, fitted.point).reading_N
    return has_clear_edges(series, residual_N, Step(values["step_N"], first, min(end, size)))
