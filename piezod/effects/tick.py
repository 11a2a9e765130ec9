"""How an effect runs in the control loop: its memory, and compiled steps that advance it by one tick.

    plan      output -> input of the effect, without a change of its states: `invert`
    commit    input -> output at the end of the tick, with the voltage that was written: `advance`

A step is a plain function (own, shared, signal) -> output. `own` is the memory of the effect: constants and states of
one model. `shared` is the memory that all effects share, read by name: `shared[SHARED.now_V]`. The chain compiles a
step when a model uses it (`piezod/model/chain/compiled_steps.py`), so a step calls compiled functions only and
allocates nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from piezod.arrays import Array
from piezod.recording.hold import Hold

Values = Mapping[str, float]


class Shared(NamedTuple):
    """Memory that all effects of a chain share: places in `shared`."""

    before_V: int  # voltage at the stack at the end of the tick before
    now_V: int  # voltage at the stack at the end of this tick; the best guess while it is planned
    committed_V: int  # voltage at the stack at the end of the tick committed last
    start_V: int  # voltage at the stack at the start
    runs_straight: int  # 1: the voltage runs straight through this tick; 0: it is held
    factor: int  # factor of the play thresholds in this tick
    offset_V: int  # offset of the play thresholds in this tick
    used_now_V: int  # 1: an inverse of this plan has used `now_V`; it is then planned once more with a better one
    force_N: int  # force at the end of the tick committed last, as far as the plan inverts it
    last_reading_N: int
    equal_readings: int  # equal readings in a row, less one
    difference_N: int  # reading less expected reading


SHARED = Shared(*range(len(Shared._fields)))


@dataclass(frozen=True)
class TickSetting:
    """Quantities that the memory of an effect depends on, besides its parameters.

    Parameters
    ----------
    dt_s
        Tick period [s].
    hold
        How the input of the effect runs within a tick.
    drive_hold
        How the voltage at the stack runs within a tick.
    force_span_N, voltage_span_V
        Ranges on which the model was identified [N], [V].
    stroke_per_V
        Sum of the weights of the plays [1].
    seen_s
        Duration of the recording in which the effects were found [s]; inf: not known.
    """

    dt_s: float
    hold: Hold
    drive_hold: Hold
    force_span_N: float
    voltage_span_V: float
    stroke_per_V: float
    seen_s: float


class Memory(Protocol):
    """Numbers of an effect, or those that all share; compiled: a pointer to them."""

    def __getitem__(self, place: int) -> float: ...

    def __setitem__(self, place: int, value: float) -> None: ...


Step = Callable[[Memory, Memory, float], float]  # function (own, shared, signal) -> output


@dataclass(frozen=True)
class Tick:
    """An effect in the control loop.

    Parameters
    ----------
    memory
        Function from values and setting to the memory of the effect: constants, then states; shape (numbers,).
    advance
        Step from input to output; the states change. HYSTERESIS only: signal is the voltage at the stack; the step
        multiplies `factor` and adds to `offset_V` in `shared`.
    invert
        Step from output to input; no state changes. None: the plan ignores the effect.
    settle
        Step as `advance`, which sets the states to rest at the input. None: the effect has no state.
    measure
        Step that takes a reading of the channel that the effect `needs`, in place of the signal; its result is unused.
    follow
        Step from (reading - expected reading) to the part of it that the effect causes, estimated from tick to tick.
    risen
        Function from values, tick period [s] and a fraction of the tick. It gives the share of the tick's change that
        has arrived by then [1]. None: all of it.
    """

    memory: Callable[[Values, TickSetting], Array]
    advance: Step | None = None
    invert: Step | None = None
    settle: Step | None = None
    measure: Step | None = None
    follow: Step | None = None
    risen: Callable[[Values, float, float], float] | None = None


@dataclass(frozen=True)
class Preview:
    """How a reference that is known ahead meets an effect that delays the reading.

    Parameters
    ----------
    late_s
        Function from values to the time by which readings follow a slow reference [s].
    shifts
        Whether the effect is a delay: the reference is led by `late_s`.
    ticks
        Ticks by which the reference must be known ahead, besides a delay.
    ahead
        Function from references (shape (N,) [N]), values and tick period [s] to the force in front of the effect.
    """

    late_s: Callable[[Values], float]
    shifts: bool = False
    ticks: int = 0
    ahead: Callable[[Array, Values, float], Array] | None = None
