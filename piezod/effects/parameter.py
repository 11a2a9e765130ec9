"""A parameter of an effect: its range of validity, and how a diagnosis searches its value."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Driven:
    """Drive of recordings: it gives the start values of a parameter, and the range that they can show.

    Parameters
    ----------
    force_span_N
        Force range on which the model was identified [N].
    top_V
        Highest command of the recordings [V].
    slow_V_per_s, usual_V_per_s, fast_V_per_s, fastest_V_per_s
        Lowest tenth, median, highest tenth and highest of the rates of the command [V/s].
    dt_s
        Shortest spacing of the samples [s].
    """

    force_span_N: float
    top_V: float
    slow_V_per_s: float
    usual_V_per_s: float
    fast_V_per_s: float
    fastest_V_per_s: float
    dt_s: float


@dataclass(frozen=True)
class Search:
    """How a diagnosis searches the value of a parameter.

    Parameters
    ----------
    starts
        Start values, within the range of the parameter. Several where the error has several minima.
    starts_for
        Function from `Driven` to start values, limited to the range of the parameter; None: `starts` for every drive.
    logarithmic
        Whether the logarithm of the value is searched; the range must lie above 0.
    nuisance
        Whether the parameter only shapes the effect. A finding does not report it.
    choices
        All values of a parameter that takes a few values only. They are tried one after the other.
    ridge
        Ridge penalty of the value 1 per sample [noise variance], at least 0.
    only_if
        Name and choice of another parameter: this one is searched with that choice only. None: always.
    seen_in
        Test of the residual that gives further starts: peaks of its spectrum, or the rate of its clock. None: no test.
    """

    starts: tuple[float, ...]
    starts_for: Callable[[Driven], tuple[float, ...]] | None = None
    logarithmic: bool = False
    nuisance: bool = False
    choices: tuple[float, ...] = ()
    ridge: float = 0.0
    only_if: tuple[str, float] | None = None
    seen_in: Literal["spectrum", "clock"] | None = None


FASTEST_MODE = 0.45  # of the sampling rate; samples show a faster oscillation as a delay


def below_the_fastest_mode(driven: Driven) -> tuple[float, float]:
    """Frequencies that the samples can show [Hz]."""
    return 0.0, FASTEST_MODE / driven.dt_s


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name
        Name that ends in the unit, unless the unit is "1".
    unit
        "s", "V/s", "1" and the like.
    low, high
        Range of validity [unit].
    search
        How a diagnosis searches the value.
    instant
        Whether it is an instant of the recording [s].
    optional
        Whether a model file may omit it. The value then is the first start.
    shown_by
        Function from `Driven` to the range that recordings can show [unit]; None: the range of validity.
    """

    name: str
    unit: str
    low: float
    high: float
    search: Search
    instant: bool = False
    optional: bool = False
    shown_by: Callable[[Driven], tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        assert self.low < self.high
        assert all(self.low <= value <= self.high for value in (*self.search.starts, *self.search.choices))
        assert not self.search.logarithmic or self.low > 0.0

    def starts(self, driven: Driven) -> tuple[float, ...]:
        """Start values for a drive, within the range of the parameter; a nuisance has one."""
        starts = self.search.starts
        if self.search.starts_for is not None:
            starts = tuple(float(np.clip(value, self.low, self.high)) for value in self.search.starts_for(driven))
        return starts[:1] if self.search.nuisance else starts

    def within(self, driven: Driven) -> "Parameter":
        """Parameter in the range that recordings can show, with its starts inside."""
        if self.shown_by is None:
            return self
        low, high = (float(np.clip(value, self.low, self.high)) for value in self.shown_by(driven))
        if not low < high:
            return self
        starts = tuple(float(np.clip(start, low, high)) for start in self.search.starts)
        return replace(self, low=low, high=high, search=replace(self.search, starts=starts))
