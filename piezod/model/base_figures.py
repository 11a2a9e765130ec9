"""Gain and loop width of the stack: two figures of the base that compare models with other operators."""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
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
        Mean opening of the loop over the input [% of the output range]. Unlike the widest opening it depends little on
        the number of operators.
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
    return figures_of_loops(hysteresis.operator().run(two_loops(low, high)), low, high)


def two_loops(low: float, high: float) -> Array:
    """Input from zero through two loops, shape (4 * BRANCH,) [input unit]."""
    down = np.linspace(high, low, BRANCH)
    return np.concatenate((np.linspace(0.0, high, BRANCH), down, down[::-1], down))


def figures_of_loops(output: Array, low: float, high: float) -> BaseFigures:
    """Figures of the second loop in the output for the input of `two_loops`, shape (4 * BRANCH,)."""
    rise, fall = output[2 * BRANCH : 3 * BRANCH], output[: 3 * BRANCH - 1 : -1]
    span = float(rise[-1] - rise[0])
    opening = float(np.trapezoid(fall - rise)) / (BRANCH - 1)
    return BaseFigures(span / (high - low), 100.0 * opening / span)
