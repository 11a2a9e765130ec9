"""Reach of the output of a model beyond the measured range."""

import numpy as np

from piezod.model.parameters import Model

MOST_BEYOND = 0.1  # share of the measured range by which a model that drives a bench may leave it
LEAST_REACHED = 0.5  # Share of the measured range that such a model must reach. A gap or a drift takes far less


def output_reach(model: Model) -> tuple[float, float]:
    """Least and largest output over courses of inputs through the model's input range [output unit].

    Every branch rises with the input, since the sums of the play weights are positive. So the largest output is that at
    the highest input, and the least one that at the lowest. A first rise from the de-energised state may begin below; a
    recording that begins amid the range has not measured it, so it does not count.

    Parameters
    ----------
    model
        Its effects are not counted.

    Raises
    ------
    ModelError
        The operator has no inverse.
    """
    low, high = model.input.low, model.input.high
    outputs = model.hysteresis.operator().run(np.array([low, high, low, high]))
    return float(outputs[2]), float(outputs[3])


def steady_range(model: Model) -> tuple[float, float]:
    """Force of the steady major loop at the low and at the high end of the input range [output unit]."""
    low, high = model.input.low, model.input.high
    _, _, top, bottom = model.operator().run(np.array([low, high, high, low]))
    return float(bottom), float(top)


def beyond_measured(model: Model) -> float:
    """Share of the measured range by which the output may leave it, at least 0."""
    least, largest = output_reach(model)
    span = model.output.high - model.output.low
    return max(0.0, model.output.low - least, largest - model.output.high) / span


def reached_share(model: Model) -> float:
    """Share of the measured range that the model reaches, by the spans of its forces.

    Parameters
    ----------
    model
        As in `output_reach`.
    """
    least, largest = output_reach(model)
    return (largest - least) / (model.output.high - model.output.low)
