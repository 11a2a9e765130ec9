"""The chain of a model in the control loop, assembled from the steps of its effects.

All numbers of a chain lie in one array `state`, and the addresses of its steps in one array `program`. A compiled
function takes two arrays faster than twenty.

    state     the operator's packed array | shared memory | direct dead zones | memory of every effect
    program   rows of `tick_steps`: places, first and last row of every stage, then a row per effect

Planned effects come first, in the order of the signal chain. Behind the last effect that the plan inverts, effects act
on the expected reading only.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from piezod.effects import EFFECTS, Location
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting
from piezod.model.chain.acting import acting_effects
from piezod.model.chain.compiled_steps import CALLED, address_of
from piezod.model.chain.tick_steps import (
    AMPLIFIER,
    END,
    FIRST,
    FIRST_EFFECT,
    FOLLOWED,
    FORCE,
    HYSTERESIS,
    MEASURED,
    OWN_AT,
    READING,
    STACK,
    measure_chain,
    plan_chain,
    settle_chain,
)
from piezod.model.parameters import Model
from piezod.operators import ImplicitInverse
from piezod.operators.compiled_cache import forget_outdated_steps
from piezod.recording.hold import HELD_ONE_SAMPLE, STRAIGHT, Hold

if TYPE_CHECKING:
    from piezod.arrays import Array

# memory of a delay: its length [ticks], numbers of the ring, ticks so far; then the ring
DELAY_TICKS, DELAY_SIZE, DELAY_COUNT, DELAY_RING = range(4)
_STAGES = {Location.AMPLIFIER: AMPLIFIER, Location.HYSTERESIS: HYSTERESIS, Location.STACK: STACK}


class TickChain:
    """Chain of a model, tick by tick.

    Parameters
    ----------
    model
        Identified or diagnosed model. Effects that belong to a single recording do not act.
    without
        Names of the effects to leave out.
    reads
        Whether the chain continues to the expected reading.

    Attributes
    ----------
    acting
        Values of the effects that act, by name.
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    program, state
        Arrays of the compiled walks in `tick_steps`.

    Raises
    ------
    ModelError
        The operator has no inverse.
    """

    def __init__(self, model: Model, dt_s: float, without: Collection[str] = (), *, reads: bool = False) -> None:
        forget_outdated_steps(plan_chain.stats.cache_path, CALLED)
        self.acting = acting_effects(model, without)
        self.delay_s = _delay_s(model, self.acting, without)
        self.dt_s = dt_s
        packed = ImplicitInverse(model.operator()).packed
        zones = np.concatenate(model.operator().dead_zones)
        self._parts: list[Array] = [packed, np.zeros(len(SHARED)), zones]
        self._rows: dict[int, list[tuple[int, int, int, int]]] = {stage: [] for stage in range(MEASURED + 1)}
        true_force = self._lay_out(model, reads=reads)
        self.program = np.zeros((FIRST_EFFECT + sum(map(len, self._rows.values())), 4), dtype=np.int64)
        row = FIRST_EFFECT
        for stage, rows in self._rows.items():
            self.program[1 + stage, FIRST], self.program[1 + stage, END] = row, row + len(rows)
            self.program[row : row + len(rows)] = np.array(rows, dtype=np.int64).reshape(-1, 4)
            row += len(rows)
        last_of_force = self.program[1 + READING, FIRST] + true_force - 1 if true_force else -1
        self.program[0] = packed.size, packed.size + len(SHARED), zones.size // 2, last_of_force
        self.state = np.concatenate(self._parts)
        self._initial = self.state.copy()
        settle_chain(self.program, self.state)
        self.measure(math.nan)  # compiled here, not in the first tick that has a temperature

    def __reduce__(self) -> NoReturn:
        """Refuse a copy for another process, in which the addresses of the steps would be wrong."""
        raise TypeError("a TickChain holds addresses of this process; build it from its model in the other process")

    def _lay_out(self, model: Model, *, reads: bool) -> int:
        """Append memory and rows of all effects; the number of READING rows that change the true force."""
        setting = TickSetting(
            self.dt_s,
            HELD_ONE_SAMPLE,
            _drive_hold(model, self.acting),
            model.output.high - model.output.low,
            model.input.high - model.input.low,
            model.hysteresis.stroke_per_V,
            model.seen_s or math.inf,
        )
        true_force, hold = 0, HELD_ONE_SAMPLE
        for name, values in self.acting.items():
            effect = EFFECTS[name].at(values)
            behind_force = effect.location > Location.STACK and (effect.tick is None or effect.tick.invert is None)
            if effect.tick is not None and effect.tick.advance is not None and (reads or not behind_force):
                now = replace(setting, hold=hold)
                stage = READING if behind_force else _STAGES.get(effect.location, FORCE)
                self._append(effect.tick, values, now, stage)
                true_force += stage == READING and effect.location is Location.MECHANICS
            hold = STRAIGHT if effect.smooths else hold
        if reads:
            ticks = ticks_late(self.delay_s, self.acting, self.dt_s)
            self._append(_delay_line(ticks), {}, setting, READING)
            # An effect that is followed acts in every drive, with another size and phase than in its recording.
            followed = {entry.name: entry.parameters for entry in reversed(model.effects)}
            for name, values in followed.items():
                if (tick := EFFECTS[name].tick) is not None and tick.follow is not None:
                    self._append(Tick(tick.memory, tick.follow), values, setting, FOLLOWED)
        return true_force

    def _append(self, tick: Tick, values: Mapping[str, float], setting: TickSetting, stage: int) -> None:
        at = sum(part.size for part in self._parts)
        self._parts.append(tick.memory(values, setting))
        settle = tick.settle or tick.advance
        self._rows[stage].append((address_of(tick.advance), address_of(tick.invert), address_of(settle), at))
        if tick.measure is not None:
            self._rows[MEASURED].append((address_of(tick.measure), 0, 0, at))

    def reset(self) -> None:
        """Return to the model's start state at rest; estimates of followed effects stay."""
        followed = int(self.program[1 + FOLLOWED, FIRST])
        any_followed = followed < self.program[1 + FOLLOWED, END]
        end = int(self.program[followed, OWN_AT]) if any_followed else self.state.size
        self.state[:end] = self._initial[:end]
        settle_chain(self.program, self.state)

    def measure(self, value: float) -> None:
        """Give a reading of a further channel to the effects that need it; nan without one."""
        if self._rows[MEASURED]:
            measure_chain(self.program, self.state, value)

    @property
    def force_N(self) -> float:
        """Force at the end of the tick committed last, in front of a resonance [N]."""
        return float(self.state[self.program[0, 0] + SHARED.force_N])


def _drive_hold(model: Model, acting: Mapping[str, object]) -> Hold:
    """How the voltage at the stack runs within a tick; a fit may have taken a held command for a straight one."""
    smooth = any(EFFECTS[name].smooths and EFFECTS[name].location is Location.AMPLIFIER for name in acting)
    return STRAIGHT if smooth or model.hold.straight else HELD_ONE_SAMPLE


def _delay_s(model: Model, acting: Mapping[str, Mapping[str, float]], without: Collection[str]) -> float:
    """Time from the end of a tick, until which its voltage is held, to the reading that shows its force [s].

    A part of the delay is in the sampling of the recording: the time from a reading to the next command. A held command
    that was fitted as a straight command arrives half a sample early in the fit.
    """
    delays = {name: p for name, effect in EFFECTS.items() if (p := effect.preview) is not None and p.shifts}
    if any(name in without for name in delays):
        return 0.0
    delay_s = sum(preview.late_s(acting[name]) for name, preview in delays.items() if name in acting)
    return delay_s + model.hold.until_next * (model.sample_s or 0.0)


def ticks_late(delay_s: float, acting: Mapping[str, Mapping[str, float]], dt_s: float) -> float:
    """Delay of the readings of a steadily rising force, when every tick holds its voltage [ticks].

    A reading shows the force at the fraction f of an earlier tick. By then the step of that tick has risen to the share
    w of its value at the end of the tick. The share 1 - w arrives one tick later. Without a lag w = 1.

    Parameters
    ----------
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    acting
        Values of the effects that act, by name.
    """
    late = delay_s / dt_s
    whole = math.floor(late)
    into = 1.0 - (late - whole)
    risen = 1.0
    for name, values in acting.items():
        tick = EFFECTS[name].tick
        risen *= tick.risen(values, dt_s, into) if tick is not None and tick.risen is not None else 1.0
    return whole + 1.0 - risen


def _advance_delay(own: Memory, _shared: Memory, force_N: float) -> float:
    count, size = int(own[DELAY_COUNT]), int(own[DELAY_SIZE])
    own[DELAY_RING + count % size] = force_N
    own[DELAY_COUNT] += 1.0
    whole = int(own[DELAY_TICKS])
    part = own[DELAY_TICKS] - whole
    return (1.0 - part) * own[DELAY_RING + (count - whole) % size] + part * own[DELAY_RING + (count - whole - 1) % size]


def _settle_delay(own: Memory, _shared: Memory, force_N: float) -> float:
    own[DELAY_COUNT] = 0.0
    for k in range(DELAY_RING, DELAY_RING + int(own[DELAY_SIZE])):
        own[k] = force_N
    return force_N


def _delay_line(ticks: float) -> Tick:
    """Step of the delay between the force and its reading: a ring of the last forces.

    Parameters
    ----------
    ticks
        Delay [ticks], at least 0.
    """
    size = math.ceil(ticks) + 2
    memory = np.concatenate(([ticks, size, 0.0], np.zeros(size)))
    return Tick(lambda _values, _setting: memory, _advance_delay, settle=_settle_delay)
