"""The record of a physical effect: its location in the signal chain, its parameters and its equations."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal

from piezod.arrays import Array
from piezod.effects.parameter import Parameter
from piezod.effects.tick import Preview, Tick
from piezod.recording.hold import STRAIGHT, Hold

Values = Mapping[str, float]


class Location(IntEnum):
    """Location of an effect in the signal chain, in the order of the chain.

    The comment gives the signal that the effect acts on. Effects of one location act in the order of `EFFECTS`.
    """

    AMPLIFIER = 1  # voltage between command and stack [V]
    HYSTERESIS = 2  # thresholds of the plays [V]
    STACK = 3  # stroke in front of the force law [V]
    MECHANICS = 4  # force [N]
    LOAD_CELL = 5  # signal of the load cell [N]
    ACQUISITION = 6  # reading [N]


Form = Literal["linear", "scaling", "additive", "memoryless", "other"]
Handling = Literal["compensated", "corrected in the reading", "refused"]


@dataclass(frozen=True)
class Context:
    """Quantities that an effect may use besides its input signal.

    Parameters
    ----------
    dt_s
        Spacing of the samples [s], above 0.
    time_s
        Time since the first sample of the recording, shape (N,) [s].
    command_V
        Commanded voltage, shape (N,) [V].
    applied_V
        Voltage at the output of the amplifier, shape (N,) [V]. Before the amplifier's effects it is the command.
    duration_s
        Duration of the recording [s].
    force_span_N
        Force range on which the model was identified [N].
    temperature_C
        Temperature, shape (N,) [degC]; None: not recorded.
    hold
        How the input signal runs between two samples.
    voltage_span_V
        Voltage range on which the model was identified [V].
    path_V
        Voltages from the de-energised state to the first sample [V].
    seen_s
        Duration of the recording in which the effect was found [s]; None: of this recording.
    stroke_per_V
        Sum of the weights of the plays: stroke per volt where all of them move [1]. 0: nothing that the voltage drives.
    drive_hold
        How `applied_V` runs between two samples; None: as the input signal.
    cache
        Last results of an effect for this `applied_V`: name to (key, result).
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
    stroke_per_V: float = 1.0
    drive_hold: Hold | None = None
    cache: dict[str, tuple[Array, Array]] = field(default_factory=dict)


Forward = Callable[[Array, Context, Values], Array]
"""Function of an effect from (signal, context, values) to its output, shape (N,), at rest at the first sample.

signal: input of the effect, shape (N,) [V or N, see `Location`]. context: the `Context` of the same N samples. values:
value by parameter name, in the unit and range of its `Parameter`; an optional parameter may be missing.
"""

Widening = Callable[[Context, Values], tuple[Array, Array]]
"""Function from context and values, as in `Forward`, to factor [1] and offset [V] of the play thresholds."""

Columns = Callable[[Context, Values], Array]
"""Function from context and values, as in `Forward`, to derivatives of the output, shape (N, weights)."""


@dataclass(frozen=True)
class Past:
    """Free decay of an effect, for recordings that begin amid the range.

    Parameters
    ----------
    count
        Number of columns.
    columns
        Function from context and values, as in `Forward`, to the decays, shape (N, count) [1].
    """

    count: int
    columns: Columns


def never(values: Values) -> bool:  # noqa: ARG001  # see `Checks.anticipates`
    """No values: the effect is causal.

    Parameters
    ----------
    values
        Values of the parameters, not used.
    """
    return False


@dataclass(frozen=True)
class Checks:
    """Properties that the contract test checks on the effect (`tests/contract/test_effects.py`).

    Parameters
    ----------
    values
        Parameter values of the main case; a parameter that is not given has its first start. On samples of 0.25 to
        4 ms the effect must be visible.
    constant
        Output for a constant input. "unchanged": the input. "shifted": another constant. "varies": a function of time.
    anticipates
        Values with which a sample depends on later samples.
    """

    values: Values = field(default_factory=dict)
    constant: Literal["unchanged", "shifted", "varies"] = "unchanged"
    anticipates: Callable[[Values], bool] = never


@dataclass(frozen=True)
class Record:
    """Quantities of recordings that the place and the plausibility of an effect depend on.

    Parameters
    ----------
    start_s, end_s
        First and last time of the recording that the effect acts in, in that recording's own time [s].
    longest_s
        Duration of the longest recording asked about [s].
    dt_s
        Shortest spacing of the samples of any recording [s].
    nyquist_Hz
        Half the sampling rate of the recording asked about [Hz].
    highest_V, fastest_V_per_s
        Highest command and its highest rate in the recordings asked about [V], [V/s].
    highest
        Upper end of the range of each parameter in these recordings, by name.
    """

    start_s: float
    end_s: float
    longest_s: float
    dt_s: float
    nyquist_Hz: float
    highest_V: float
    fastest_V_per_s: float
    highest: Values


Where = tuple[str, float, float]  # axis of a place, and its low and high end [unit of the axis]
LATE = 0.05  # of a sample: a shift of less is the moment of reading


def everywhere(values: Values, record: Record) -> Where | None:  # noqa: ARG001  # see `Effect.place`
    """No place: the effect acts wherever the bench moves."""
    return None


def at_its_frequency(values: Values, record: Record) -> Where | None:  # noqa: ARG001  # see `Effect.place`
    """The line of its parameter `frequency_Hz`."""
    return "frequency_Hz", values["frequency_Hz"], values["frequency_Hz"]


def all_the_time(values: Values, record: Record) -> Where | None:  # noqa: ARG001  # see `Effect.place`
    """From the first to the last sample of its recording."""
    return "time_s", record.start_s, record.end_s


def always(values: Values, record: Record) -> bool:  # noqa: ARG001  # see `Effect.plausible`
    """Any values within the ranges of the parameters suit the name."""
    return True


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Parameters
    ----------
    name
        Name in models and findings.
    title
        Name in words.
    location
        Location in the signal chain.
    form
        "linear": the output is a linear function of the signal, with or without memory. "scaling": the signal times a
        factor of time alone. "additive": the added term does not depend on the signal. "memoryless": a function of the
        present sample. "other": none of these.
    parameters
        Parameters that a finding reports, then nuisances.
    forward
        Function from input signal to output signal, both of shape (N,). It is at rest at the first sample.
    handling
        Handling by the compensator.
    docstring
        Docstring of the file: six fields.
    why
        Reason why the effect is not compensated; empty where it is.
    tick
        The effect in the control loop; None: it does not act there.
    preview
        How a reference known ahead meets the effect; None: it delays no reading.
    behind_law
        STACK only: parameter and its choice with which the effect acts behind the force law; None: it never does.
    widening
        HYSTERESIS only: factor [1] and offset [V] of all play thresholds above 0, each of shape (N,).
    weights
        Names of consecutive parameters in which the added term is linear; `columns` gives the factors.
    columns
        STACK only: derivatives of the output by the weights, shape (N, weights).
    smooths
        Whether the output runs straight between samples when the input is held.
    past
        Decays of an unknown past in the readings; None: the state is forgotten within seconds.
    needs
        Channel that a recording must have; None: no further channel.
    separate_by
        Experiment that separates the effect from its look-alikes.
    place
        Function from values and `Record` to where the effect acts; None: everywhere.
    plausible
        Function from values and `Record` to whether fitted values suit the name of the effect.
    flexible
        Whether it bends to nearly whatever is left, so that it must gain in many blocks of time.
    soft
        Whether it bends to whatever is left at low force.
    general
        Whether it bends to nearly whatever is a hysteresis: one with a shape of its own goes before it.
    narrow
        Whether its response to a step is a sample wide, so that it is searched behind a delay at its own place.
    found_by
        "search": hypotheses that are fitted. "test": a test of the residual.
    repeats
        Whether another recording of the same drive shows it again.
    checks
        Properties that the contract test checks.
    """

    name: str
    title: str
    location: Location
    form: Form
    parameters: tuple[Parameter, ...]
    forward: Forward
    handling: Handling
    docstring: str
    why: str = ""
    tick: Tick | None = None
    preview: Preview | None = None
    behind_law: tuple[str, float] | None = None
    widening: Widening | None = None
    weights: tuple[str, ...] = ()
    columns: Columns | None = None
    smooths: bool = False
    past: Past | None = None
    needs: str | None = None
    separate_by: str = ""
    place: Callable[[Values, Record], Where | None] = everywhere
    plausible: Callable[[Values, Record], bool] = always
    flexible: bool = False
    soft: bool = False
    general: bool = False
    narrow: bool = False
    found_by: Literal["search", "test"] = "search"
    repeats: bool = True
    checks: Checks = field(default_factory=Checks)
    _by_name: dict[str, Parameter] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._by_name.update({one.name: one for one in self.parameters})

    def at(self, values: Values) -> "Effect":
        """The effect at the location that its choices among `values` give it."""
        if self.behind_law is None:
            return self
        name, behind = self.behind_law
        location = Location.MECHANICS if values.get(name) == behind else Location.STACK
        return self if location is self.location else replace(self, location=location)

    @property
    def size(self) -> Parameter:
        """Parameter that says how strong the effect is, or where it acts: the first one."""
        return self.parameters[0]

    @property
    def catalogued(self) -> tuple[Parameter, ...]:
        """Parameters that a finding reports."""
        return tuple(one for one in self.parameters if not one.search.nuisance)

    @property
    def is_delay(self) -> bool:
        """Whether the effect shifts the readings in time."""
        return self.preview is not None and self.preview.shifts

    @property
    def is_step(self) -> bool:
        """Whether the effect adds a constant between two instants."""
        return self.form == "additive" and any(parameter.instant for parameter in self.parameters)

    @property
    def is_tone(self) -> bool:
        """Whether the effect adds a sine and its harmonics."""
        return self.form == "additive" and any(parameter.name == "frequency_Hz" for parameter in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Parameter of that name.

        Raises
        ------
        KeyError
            The effect has no such parameter.
        """
        return self._by_name[name]


def unchanged(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Output of an effect that changes no signal.

    Parameters
    ----------
    signal
        Input signal, shape (N,).
    context, values
        Not used.
    """
    return signal
