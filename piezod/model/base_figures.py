"""Gain and loop width of the stack: two figures of the base that compare models with other operators."""

from dataclasses import dataclass

import numpy as np

from piezod.model.parameters import Hysteresis

BRANCH = 400  # samples of a branch of the loop


@dataclass(frozen=True)
class BaseFigures:
    """Figures of the loop between two inputs.

    Parameters
    ----------
    gain
        Output range over input range [output unit per input unit].
    loop_width_percent
        Widest opening of the loop [% of the output range].
    """

    gain: float
    loop_width_percent: float


def base_figures(hysteresis: Hysteresis, low: float, high: float) -> BaseFigures:
    """Figures of the second loop between two inputs, driven from the de-energised state.

    Parameters
    ----------
    low, high
        Ends of the loop, low below high [input unit].
    """
    down = np.linspace(high, low, BRANCH)
    up = down[::-1]
    operator = hysteresis.operator()
    operator.run(np.concatenate((np.linspace(0.0, high, BRANCH), down)))
    rise = operator.run(up)
    fall = operator.run(down)[::-1]
    span = float(rise[-1] - rise[0])
    return BaseFigures(span / (high - low), 100.0 * float(np.max(np.abs(fall - rise))) / span)
