"""What an effect is: one piece of physics in its place in the signal chain, with parameters, units and ranges."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.recording.hold import STRAIGHT, Hold

Array = NDArray[np.float64]
Values = Mapping[str, float]


class Seat(IntEnum):
    """What an effect acts on, in the order of the signal chain; effects of one seat act in the order of `EFFECTS`.

    AMPLIFIER: the voltage [V] between command and stack. HYSTERESIS: the plays themselves. STACK: what the plays give
    [V], in front of the force law. MECHANICS: the force [N]. LOAD_CELL: the signal [N]. ACQUISITION: the reading [N].
    """

    AMPLIFIER = 1
    HYSTERESIS = 2
    STACK = 3
    MECHANICS = 4
    LOAD_CELL = 5
    ACQUISITION = 6


Form = Literal["linear", "additive", "memoryless", "other"]
Handling = Literal["compensated", "corrected in the reading", "refused"]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name
        With its unit at the end, where it has one.
    unit
        "s", "V/s", "1" ...
    low, high
        Range of validity; a search stays inside.
    starts
        Where a search may begin; more than one where the error has several valleys.
    logarithmic
        Whether it is searched on a logarithmic scale; then `low` is above 0.
    nuisance
        Shapes the effect but is no part of the catalogue's interface.
    choices
        The few values it can have, for a parameter that is not searched but tried.
    place
        Whether it names an instant of the record [s].
    stiffness
        What a value of one costs a sample, in parts of its noise's variance: it stays near zero where little tells.
    only_if
        Another parameter and the choice of it with which this one is searched; None: with any.
    may_lack
        Whether a model may leave it out: it is at its first start then.
    """

    name: str
    unit: str
    low: float
    high: float
    starts: tuple[float, ...]
    logarithmic: bool = False
    nuisance: bool = False
    choices: tuple[float, ...] = ()
    place: bool = False
    stiffness: float = 0.0
    only_if: tuple[str, float] | None = None
    may_lack: bool = False

    def __post_init__(self) -> None:
        assert self.low < self.high
        assert all(self.low <= start <= self.high for start in (*self.starts, *self.choices))
        assert not self.logarithmic or self.low > 0.0


@dataclass(frozen=True)
class Context:
    """What an effect may look at besides the signal that it changes.

    Parameters
    ----------
    dt_s
        Spacing of the samples [s].
    time_s
        Time of each since the record's first sample, shape (N,) [s].
    command_V
        Commanded voltage, shape (N,) [V].
    applied_V
        What the amplifier made of it, shape (N,) [V]; the command until the amplifier has acted.
    duration_s
        Of the record [s].
    force_span_N
        Range of the force that the model was identified over [N].
    temperature_C
        Where it was recorded, shape (N,) [degC].
    hold
        How the signal runs between two samples.
    voltage_span_V
        Range of the voltage that the model was identified over [V].
    path_V
        Voltages since the de-energised state, before the first sample.
    seen_s
        How long the record was in which an effect was found; None: this one [s].
    memo
        What an effect computed from an `applied_V`, which comes first, and may want again for the same one.
    """

    dt_s: float
    time_s: Array
    command_V: Array
    applied_V: Array
    duration_s: float
    force_span_N: float
    temperature_C: Array | None = None
    hold: Hold = STRAIGHT
    voltage_span_V: float = 100.0
    path_V: tuple[float, ...] = ()
    seen_s: float | None = None
    memo: dict[str, tuple[Array, Array]] = field(default_factory=dict)


Forward = Callable[[Array, Context, Values], Array]
Widening = Callable[[Context, Values], tuple[Array, Array]]
Columns = Callable[[Context, Values], Array]


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Parameters
    ----------
    name
        As in the findings.
    title
        In a few words for people.
    seat
        Where it acts.
    form
        "linear": the output is a linear function of the signal (with memory or not), and a column of a linear model
        passes through it like the signal; "additive": what is added does not depend on the signal; "memoryless": a
        function of the present sample; "other".
    parameters
        Those of the catalogue first, then nuisances.
    forward
        Signal in, signal out, both shape (N,). From rest at the first sample: a constant signal stays as it is for a
        record that starts where the bench rested.
    handling
        What the compensator does about it.
    why
        Why it is corrected in the reading or refused; empty where it is compensated.
    widening
        Of the seat HYSTERESIS alone: factor (1) and offset [V] of all play thresholds, each shape (N,).
    weights
        Names of parameters, next to each other, that what it adds is linear in, where `columns` knows them.
    columns
        Of the seat STACK alone: how the output changes with each weight, shape (N, weights).
    smooths
        Whether a held signal runs straight between samples behind it.
    needs
        Channel that must have been recorded, or None.
    separate_by
        The experiment that tells it from its look-alikes.
    """

    name: str
    title: str
    seat: Seat
    form: Form
    parameters: tuple[Parameter, ...]
    forward: Forward
    handling: Handling
    docstring: str
    why: str = ""
    widening: Widening | None = None
    weights: tuple[str, ...] = ()
    columns: Columns | None = None
    smooths: bool = False
    needs: str | None = None
    separate_by: str = ""
    _by_name: dict[str, Parameter] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._by_name.update({one.name: one for one in self.parameters})

    @property
    def catalogued(self) -> tuple[Parameter, ...]:
        """Parameters of the interface, without nuisances."""
        return tuple(one for one in self.parameters if not one.nuisance)

    def parameter(self, name: str) -> Parameter:
        """One of its parameters.

        Raises
        ------
        KeyError
            It has none of that name.
        """
        return self._by_name[name]


def unchanged(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """The forward of an effect that does not act on a signal of its own."""
    return signal
