"""The forward chain: from the voltage that is applied to the force that the model expects."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.model.parameters import Model


class Plant:
    """A model made to run forwards.

    Parameters
    ----------
    model
        What was identified; the plant starts in its start state.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._operator = model.operator()

    def reset(self) -> None:
        """Back to the model's start state."""
        self._operator = self.model.operator()

    def step(self, voltage_V: float) -> float:
        """Advance by one sample and return the force [unit of the model's output]."""
        return self._operator.step(voltage_V)

    def run(self, voltage_V: ArrayLike) -> NDArray[np.float64]:
        """Advance over a record, shape (N,), and return the forces."""
        return self._operator.run(voltage_V)

    def steady_range(self) -> tuple[float, float]:
        """Force at the low and at the high end of the input range on the steady major loop."""
        operator = self.model.operator()
        low, high = self.model.input.low, self.model.input.high
        _, _, top, bottom = operator.run([low, high, high, low])
        return float(bottom), float(top)
