"""Short formula for an unnamed law, if it predicts as well as the tables of the law.

    a f(d / b),  f from a small library, times the direction if the law has it, behind at most one lag

The library holds common shapes: proportional, square, absolute, root, saturating and decaying. The formula is reported
in addition to the tables.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.model.unnamed_law import Driver

PARTS = tuple(float(part) for part in np.geomspace(0.03, 1.0, 10))
"""Scales of a curved shape that are tried, relative to the largest value of the driver."""


@dataclass(frozen=True)
class Shape:
    """Shape in the library.

    Parameters
    ----------
    function
        Function of the driver over its scale, shape (N,).
    text
        Text of the formula, with {0} for the driver over its scale.
    bent
        Whether the scale changes the shape; otherwise it is only a unit.
    """

    function: Callable[[Array], Array]
    text: str
    bent: bool = False


SHAPES = (
    Shape(lambda x: x, "({0})"),
    Shape(np.square, "({0})^2"),
    Shape(np.abs, "|{0}|"),
    Shape(lambda x: np.sign(x) * np.sqrt(np.abs(x)), "sqrt({0})"),
    Shape(np.tanh, "tanh({0})", bent=True),
    Shape(lambda x: np.exp(-np.abs(x)), "exp(-|{0}|)", bent=True),
    Shape(lambda x: x / (1.0 + np.abs(x)), "({0}) / (1 + |{0}|)", bent=True),
)


@dataclass(frozen=True)
class Formula:
    """Formula with its numbers.

    Parameters
    ----------
    shape
        Shape in the library.
    driver, scale
        Driver and its divisor [unit of the driver].
    directed
        Whether it is multiplied by the direction of the command, 1 or -1.
    memory_s
        Time constant of the lag behind it [s]; 0: none.
    factor
        Factor [output unit, or 1 for a gain].
    """

    shape: Shape
    driver: Driver
    scale: float
    directed: bool
    memory_s: float
    factor: float = 1.0

    def values(self, driver: Array, direction: Array) -> Array:
        """Values without factor and lag, from the driver and the direction of the command, shape (N,) each."""
        shaped = self.shape.function(driver / self.scale)
        return shaped * direction if self.directed else shaped

    def text(self, input_unit: str, output_unit: str, *, gain: bool) -> str:
        """Text with the units of the model, such as `-1.2 N x tanh(rate / 35 V/s), behind a lag of 0.3 s`.

        A `gain` has a factor without unit.
        """
        unit = {
            "command": input_unit,
            "rate": f"{input_unit}/s",
            "way": input_unit,
            "stroke": input_unit,
            "reading": output_unit,
            "reading_rate": f"{output_unit}/s",
        }.get(self.driver, "")
        name = self.driver.replace("_", " ")
        argument = f"{name} / {self.scale:.3g} {unit}".rstrip()
        factor = f"{self.factor:.3g}" if gain else f"{self.factor:.3g} {output_unit}"
        text = f"{factor} x {self.shape.text.format(argument)}"
        text += " x direction" if self.directed else ""
        return text + (f", behind a lag of {self.memory_s:.2g} s" if self.memory_s > 0.0 else "")


def candidates(driver: Driver, high: float, memories_s: tuple[float, ...], *, directed: bool) -> Iterator[Formula]:
    """All formulas of the library for a driver with this largest value, with each scale and lag."""
    power_of_ten = 10.0 ** math.floor(math.log10(high))
    for shape in SHAPES:
        for scale in [part * high for part in PARTS] if shape.bent else [power_of_ten]:
            for memory_s in memories_s:
                yield Formula(shape, driver, scale, directed, memory_s)
