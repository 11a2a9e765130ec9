"""Whether one more effect is believed: what it gains, how steadily, and whether it is what its name says."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.steps import Step, sharp, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.record import record_of
from piezod.effects import EFFECTS

Array = NDArray[np.float64]

WORTH, STEADILY = 0.22, 5.0
"""An effect must gain WORTH exp(-steadiness / STEADILY) of the loss that it leaves. Both were chosen by 921 decisions
in 422 replay files of four families, the same with each family left out (`python -m tests.studies rules`)."""

STEADY = 3.0  # on the same files it loses no hidden effect, and keeps out five of 25 false ones in foreign cases
BETTER = 0.98  # of the loss: below it a hypothesis is preferred to another one
ALONE = 10.0  # times the loss within the fit: 99.9 % of all blocks stay below it
MOST_OF_A_BLOCK = 3.0  # times the median gain
BEGIN = 0.02  # of a recording: a step within it is what an unknown start leaves
PLAINER = 0.01  # of the loss, that a parameter must bring,
MOST_COUNTED = 8  # if not so many count already: of many that are stiff few are used
MORE, LEAVES = 0.1, 0.5  # of its gain, though no more of its loss, that a general effect must be better than another


def worth(before: Fitted, after: Fitted) -> bool:
    """Whether an effect gains enough on blocks left out: the less, the more steadily it gains in them."""
    before, after = comparable(before, after)
    return before.loss - after.loss > least_gain(steadiness(before, after)) * after.loss


def steady_enough(before: Fitted, after: Fitted) -> bool:
    """Whether the last effect has a shape of its own, or gains in so many blocks that it is no chance."""
    return not after.terms[-1].effect.flexible or steadiness(*comparable(before, after)) > STEADY


def comparable(before: Fitted, after: Fitted) -> tuple[Fitted, Fitted]:
    """Both with the loss within the fit in each block that neither predicts from the others: it is like no other."""
    alone = (before.losses > ALONE * before.in_fit) & (after.losses > ALONE * after.in_fit)
    first, second = (replace(one, losses=np.where(alone, one.in_fit, one.losses)) for one in (before, after))
    return first, second


def least_gain(steady: float, worth: float = WORTH, steadily: float = STEADILY) -> float:
    """What an effect must gain, of the loss that it leaves.

    Parameters
    ----------
    steady
        Its steadiness.
    worth, steadily
        Least gain of an effect without any, and the steadiness that lowers it to 1 / e.
    """
    return worth * math.exp(-steady / steadily)


def weighed(fitted: Fitted) -> float:
    """The loss, a little more of it for every parameter that the last effect is shaped by: of two alike the plainer."""
    return fitted.loss * (1.0 + PLAINER * min(len(fitted.terms[-1].searched), MOST_COUNTED))


def counted(name: str, without_it: float, with_it: float) -> float:
    """The loss that an effect is compared with others by in its place: less of what a general one gains counts."""
    if not EFFECTS[name].general:
        return with_it
    return with_it + min(MORE * max(without_it - with_it, 0.0), LEAVES * with_it)


def steadiness(before: Fitted, after: Fitted) -> float:
    """Sum of the blocks' logarithmic gains over its standard deviation if their signs were chance.

    A block that gains or loses far more than most counts no more than some of them: it would drown what they say.
    """
    seen = (before.samples > 0) & (after.samples > 0)
    gains = np.log(before.losses[seen] / after.losses[seen])
    touched = gains[np.abs(gains) > 1e-3]
    if touched.size < 4:
        return 0.0
    most = MOST_OF_A_BLOCK * float(np.median(np.abs(touched)))
    touched = np.clip(touched, -most, most)
    return float(np.sum(touched)) / float(np.sqrt(np.sum(touched**2)))


def degenerate(chain: Chain, fitted: Fitted) -> bool:
    """Whether the last effect is not what its name says.

    A step without edges is a drift, and one at the begin is what an unknown start leaves.
    """
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if not term.effect.plausible(values, record_of(term, chain)):
        return True
    return any(one.instant for one in term.effect.parameters) and not _is_a_step(chain, fitted)


def _is_a_step(chain: Chain, fitted: Fitted) -> bool:
    """Whether the last effect, a step, has edges, and is not all over or there to stay soon after the begin."""
    term, values = fitted.terms[-1], fitted.point.values[-1]
    series = chain.series[term.series]
    size, begin = series.time_s.size, BEGIN * series.time_s.size
    late_s = shown_late_s(chain, fitted.terms, fitted.point)
    first, end = (round((values[name] + late_s) / series.dt_s) for name in ("on_s", "off_s"))
    if end <= begin or (end >= size and first < begin):
        return False
    residual_N = series.reading_N - chain.run(term.series, fitted.terms, fitted.point).reading_N
    return sharp(series, residual_N, Step(values["step_N"], first, min(end, size)))
