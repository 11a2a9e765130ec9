"""Figures of one block of driving: how far the force is from the model, and which input was driven."""

from dataclasses import dataclass
from math import floor, isfinite, log2, nan, pi, sqrt
from typing import NamedTuple

import numpy as np

from piezod.arrays import Array

PARTS = 4  # of the model's input range, for the ends of what a block drives
SLOWEST = 1e-3  # rate that counts as rest [input ranges per s]
KELVIN = 5.0  # step of the temperature [K]


class Cell(NamedTuple):
    """Kind of input of a block; blocks of one cell are compared with each other.

    Parameters
    ----------
    low, high
        Ends of the driven voltages, in quarters of the model's input range.
    rate
        Power of two of the rms rate [V/s].
    frequency
        Power of two of the rms frequency [Hz], which is the rms rate over 2 pi times the standard deviation.
    temperature
        Temperature in steps of 5 K; 0 without a thermometer.
    """

    low: int
    high: int
    rate: int
    frequency: int
    temperature: int


@dataclass(frozen=True)
class Block:
    """Figures of a block.

    Parameters
    ----------
    rms_N, mean_N
        Standard deviation and mean of the difference of force and model [N].
    low_V, high_V, rate_V_per_s, frequency_Hz
        Driven range, rms rate and rms frequency of the voltage.
    temperature_C
        Mean temperature [degC]; nan without a thermometer.
    """

    rms_N: float
    mean_N: float
    low_V: float
    high_V: float
    rate_V_per_s: float
    frequency_Hz: float
    temperature_C: float

    def cell(self, range_V: tuple[float, float]) -> Cell:
        """Kind of input; `range_V` is the input range of the model [V]."""
        low_V, span_V = range_V[0], range_V[1] - range_V[0]
        rests = self.rate_V_per_s < SLOWEST * span_V
        return Cell(
            floor(PARTS * (self.low_V - low_V) / span_V),
            -floor(-PARTS * (self.high_V - low_V) / span_V),
            floor(log2(SLOWEST * span_V)) - 1 if rests else floor(log2(self.rate_V_per_s)),
            0 if rests else floor(log2(self.frequency_Hz)),
            round(self.temperature_C / KELVIN) if isfinite(self.temperature_C) else 0,
        )

    def distance_N(self, offset_N: float, ignored_N: float) -> float:
        """Distance from the model [N]: the spread, with what an offset has beyond `ignored_N` [N]."""
        return sqrt(self.rms_N**2 + max(abs(offset_N) - ignored_N, 0.0) ** 2)


class BlockSums:
    """Sums over the ticks of one block, filled piece by piece.

    Parameters
    ----------
    dt_s
        Tick period [s].
    """

    def __init__(self, size: int, dt_s: float) -> None:
        self._size, self._dt_s = size, dt_s
        self._last_V = nan
        self._clear()

    def add(self, difference_N: Array, voltage_V: Array, temperature_C: float) -> list[Block]:
        """Add ticks, differences and voltages of shape (N,); the result are the blocks that became complete."""
        blocks = []
        while difference_N.size:
            count = min(self._size - self._count, difference_N.size)
            self._add(difference_N[:count], voltage_V[:count], temperature_C)
            difference_N, voltage_V = difference_N[count:], voltage_V[count:]
            if self._count >= self._size:
                blocks.append(self._block())
                self._clear()
        return blocks

    def _clear(self) -> None:
        self._count = 0
        self._sum_N = self._squares_N = self._sum_V = self._squares_V = self._steps_V = self._sum_C = 0.0
        self._low_V, self._high_V = float("inf"), -float("inf")

    def _add(self, difference_N: Array, voltage_V: Array, temperature_C: float) -> None:
        steps_V = np.diff(voltage_V, prepend=voltage_V[0] if np.isnan(self._last_V) else self._last_V)
        self._last_V = float(voltage_V[-1])
        self._count += difference_N.size
        self._sum_N += float(difference_N.sum())
        self._squares_N += float(difference_N @ difference_N)
        self._sum_V += float(voltage_V.sum())
        self._squares_V += float(voltage_V @ voltage_V)
        self._steps_V += float(steps_V @ steps_V)
        self._sum_C += temperature_C * difference_N.size
        self._low_V = min(self._low_V, float(voltage_V.min()))
        self._high_V = max(self._high_V, float(voltage_V.max()))

    def _block(self) -> Block:
        count = self._count
        mean_N, mean_V = self._sum_N / count, self._sum_V / count
        rate = sqrt(self._steps_V / count) / self._dt_s
        deviation_V = sqrt(max(self._squares_V / count - mean_V**2, 0.0))
        return Block(
            rms_N=sqrt(max(self._squares_N / count - mean_N**2, 0.0)),
            mean_N=mean_N,
            low_V=self._low_V,
            high_V=self._high_V,
            rate_V_per_s=rate,
            frequency_Hz=max(rate / (2.0 * pi * deviation_V), 1e-6) if deviation_V > 0.0 else 1e-6,
            temperature_C=self._sum_C / count,
        )
