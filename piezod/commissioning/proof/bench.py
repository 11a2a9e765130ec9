"""The bench of a proof test: hold a low voltage with the ordinary control loop, and measure the reaction."""

from dataclasses import dataclass
from math import inf, isfinite, nan
from typing import cast

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.proof.links import UNCHANGED, ChangedLink, Changes
from piezod.commissioning.proof.record import ProofStep, word
from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, ControlLoop, RateKeeper, RingReader, Segment, State, TableReference
from piezod.control import check_ready as check_ready_to_arm
from piezod.control.rate_keeper import VirtualRateKeeper
from piezod.errors import CheckFailedError, UnreachableError
from piezod.model import DirectDrive
from piezod.runtime import clock
from piezod.transport import ExchangeResult, Link

PROOF_SHARE = 0.05  # of the voltage range: the level of the test
LEAST_STEPS = 2.5  # level in units of arming.sign_check.step_V, so that the sign check stays below the force trip
HOLD_S = 0.5  # time at the level
LEAST_TICKS = 40  # at the level, at any rate: each trip needs some samples
FALLEN = 0.2  # of the level: end of a hold that falls
TRY_S = 1.0  # of the watchdog, beyond its time: a slow amplifier falls that long
POLLS = 5
TICKS_TO_REACT = 2.5  # from a debounce's last sample to the command that it changes, two; half a tick is jitter
LATE_TICKS = 0.1  # of a tick that is made to miss its deadline

Rows = NDArray[np.bool_]
Measured = tuple[float, float, str]
"""Measured value, its limit, and their unit."""


@dataclass(frozen=True)
class Run:
    """One arming of the bench: its rows and its end.

    Parameters
    ----------
    rows
        Rows of the ring log, shape (N,).
    fault
        Latched fault; `Cause.NONE` after a stop or the end of the hold.
    """

    rows: NDArray[np.void]
    fault: Cause

    @property
    def tripped(self) -> NDArray[np.bool_]:
        """Whether a row belongs to the ramp down or to the fault, shape (N,)."""
        return np.isin(self.rows["state"], (State.RAMP_DOWN, State.FAULT))

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Whether a row is RUNNING, shape (N,): the level is reached."""
        running: NDArray[np.bool_] = self.rows["state"] == State.RUNNING
        return running

    @property
    def since_level(self) -> NDArray[np.bool_]:
        """Whether a row is at the level or after it, shape (N,): a change by a step begins there."""
        return self.reached | self.tripped

    @property
    def skipped_ticks(self) -> NDArray[np.bool_]:
        """Whether a row comes after a skipped tick, shape (N,)."""
        return np.diff(self.rows["tick"], prepend=self.rows["tick"][:1]) > 1

    @property
    def at_level(self) -> NDArray[np.void]:
        """Rows of the second half of the hold, shape (M,); the output has settled there."""
        good = np.flatnonzero((self.rows["state"] == State.RUNNING) & (self.rows["result"] == 0))
        return np.take(self.rows, good[good.size // 2 :])

    @property
    def force_N(self) -> float:
        """Mean force at the level [N]."""
        return float(self.at_level["force_N"].mean()) if self.at_level.size else nan

    @property
    def highest_N(self) -> float:
        """Highest force [N]."""
        return float(self.rows["force_N"].max()) if self.rows.size else nan

    @property
    def lowest_N(self) -> float:
        """Lowest force [N]."""
        return float(self.rows["force_N"].min()) if self.rows.size else nan

    @property
    def readback_V(self) -> float:
        """Mean voltage read back at the level [V]; nan without read-back."""
        return float(self.at_level["readback_V"].mean()) if self.at_level.size else nan

    @property
    def readback_error_V(self) -> float:
        """Largest difference of written and read voltage at the level [V]; nan without read-back."""
        rows = self.at_level
        return float(np.abs(rows["readback_V"] - rows["voltage_V"]).max()) if rows.size else nan

    @property
    def left_V(self) -> float:
        """Voltage read back at the end [V]; the written voltage where the device has no read-back."""
        last = self.rows[-1]
        return float(last["readback_V"] if isfinite(last["readback_V"]) else last["voltage_V"])

    def time_to_fault_ms(self, wrong: NDArray[np.bool_]) -> float:
        """Time from the first wrong row while RUNNING, or in the approach, to the latched fault [ms]; inf: none."""
        first, last = np.flatnonzero(wrong), np.flatnonzero(self.tripped)  # at rest no ramp follows
        if not (first.size and last.size) or self.fault is Cause.NONE:
            return inf
        return max(0.0, float(self.rows["time_ns"][last[0]] - self.rows["time_ns"][first[0]]) / 1e6)

    def time_of_ramp_ms(self) -> float:
        """Time from the begin of the ramp down to its end [ms]; inf: it did not end."""
        ramp = np.flatnonzero(self.rows["state"] == State.RAMP_DOWN)
        if not ramp.size or self.rows["state"][-1] not in (State.DISARMED, State.FAULT):
            return inf
        return float(self.rows["time_ns"][-1] - self.rows["time_ns"][ramp[0]]) / 1e6

    def step(self, name: str, wrong: Rows, limit_ms: float, measured: Measured | None, *causes: Cause) -> ProofStep:
        """Result of a step whose fault must be one of `causes`, in time.

        Parameters
        ----------
        wrong
            Whether a row must trip, shape (N,).
        limit_ms
            Longest time from the first of them to the fault [ms].
        measured
            None: the time and its limit [ms].
        """
        time_ms = self.time_to_fault_ms(wrong)
        right = self.fault in causes and time_ms <= limit_ms
        value, limit, unit = measured or (time_ms, limit_ms, "ms")
        return ProofStep(name, word(right), value, limit, unit, time_ms, self.outcome(limit_ms))

    def outcome(self, limit_ms: float) -> str:
        """Text of the end, with the limit of its time [ms]."""
        text = "no fault" if self.fault is Cause.NONE else CAUSE_TEXT[self.fault].partition(";")[0]
        return f"{text}; time limit {limit_ms:.1f} ms"


class _LevelDrive:
    """The level of the test, for any requested force."""

    def __init__(self, level_V: float) -> None:
        self._level_V = level_V

    def reset(self) -> None:
        """No effect: there is no state."""

    def plan(self, reference: float) -> float:  # noqa: ARG002  # the signature of a compensator
        """Voltage of the level [V]."""
        return self._level_V

    def commit(self, voltage_V: float) -> None:
        """No effect: there is no state."""

    def produced_N(self) -> float:
        """nan: there is no model."""
        return nan


class ProofBench:
    """Holds the level of the test as often as a step needs it.

    Parameters
    ----------
    bench, link, clock
        Bench configuration, its opened link and the clock of its loop.

    Attributes
    ----------
    link
        Link to drive through, whose readings a step can change.
    level_V
        Voltage of the test [V].
    rest_N, level_N
        Force at rest and at the level [N]; nan before the first step.
    """

    def __init__(self, bench: BenchConfig, link: Link, clock: RateKeeper) -> None:
        limits = bench.limits
        self.bench, self._clock = bench, clock
        self._changed = ChangedLink(link, self.level_reached)
        self.link = cast("Link", self._changed)
        low_V, span_V = limits.voltage_safe_V, limits.voltage_max_V - limits.voltage_safe_V
        self.level_V = low_V + min(span_V, max(PROOF_SHARE * span_V, LEAST_STEPS * bench.arming.sign_check.step_V))
        self.readback_limit_V = limits.readback_trip_V or bench.arming.readback_within_V
        self.watchdog_limit_ms = limits.device_watchdog_ms + limits.readback_trip_ms + 2e3 * bench.dt_s
        self.rest_N = self.level_N = nan
        self._loop: ControlLoop
        self._reader: RingReader

    def begin(self, loop: ControlLoop) -> None:
        """Drive with `loop`, which drives through `link`."""
        self._loop, self._reader = loop, RingReader(self.bench.ring_log_path)

    @property
    def interrupted(self) -> bool:
        """Whether a stop came."""
        return self._loop.stopped

    def level_reached(self) -> bool:
        """Whether the level is held now."""
        return self._loop.supervisor.state is State.RUNNING

    def read_force_N(self) -> float:
        """Force now [N].

        Raises
        ------
        UnreachableError
            The device gives no good reading.
        """
        for _ in range(POLLS):
            if (result := self.link.poll()) == ExchangeResult.OK:
                return self.link.reading.force_N
            self._clock.wait()
        raise UnreachableError(f"proof: {self.link.description}: {result.name.lower()}: check cable and device")

    def reaction_ms(self, samples: float) -> float:
        """Longest time from the first of `samples` wrong samples to the reaction [ms]."""
        return 1e3 * (samples + TICKS_TO_REACT) * self.bench.dt_s

    @property
    def ticks_of_hold(self) -> int:
        """Length of an ordinary hold [ticks]."""
        return self._ticks(HOLD_S)

    @property
    def has_deadlines(self) -> bool:
        """Whether a tick can be late: virtual time waits for it."""
        return not isinstance(self._clock, VirtualRateKeeper)

    @property
    def in_odd_tick(self) -> bool:
        """Whether the number of this tick is odd."""
        return bool(self._clock.tick % 2)

    def hold_level(
        self,
        *,
        tightened: dict[str, float] | None = None,
        changes: Changes = UNCHANGED,
        stops: bool = False,
        late: bool = False,
        cold: bool = False,
        lasts_s: float = HOLD_S,
        falls: bool = False,
        expected_N: float | None = None,
    ) -> Run:
        """Arm, hold the level and ramp down.

        Parameters
        ----------
        tightened
            Limits in place of the configured ones, by their keys; the caller makes each tighter, never looser.
        changes
            Changes of the readings at the level.
        stops
            Whether a stop is requested in the middle of the hold.
        late
            Whether each tick at the level misses its deadline.
        cold
            Whether the interlock of the heat counts from zero; what the stack had before is added at the end.
        lasts_s
            Duration of the hold [s].
        falls
            Whether the voltage falls to `FALLEN` of the level in the second half of the hold.
        expected_N
            Force that is expected at the level [N]; None: unknown.

        Raises
        ------
        CheckFailedError
            A precondition of arming fails, or the test was interrupted.
        """
        loop, supervisor, limits = self._loop, self._loop.supervisor, self.bench.limits
        held, half = 0, self._ticks(lasts_s) // 2
        before_W = supervisor.heat_W if cold else 0.0
        supervisor.heat_W -= before_W
        loop.set_limits(limits.model_copy(update=tightened))
        self._changed.changes = changes
        try:
            self._arm(self._segment(lasts_s, falls, expected_N))
            while supervisor.driving:
                loop.run_tick()
                held += self.level_reached()
                if stops and held == half:
                    supervisor.stop()
                if late and self.level_reached():
                    clock.sleep(max(0.0, 1e-9 * self._clock.time_left_ns()) + LATE_TICKS * self.bench.dt_s)
                loop.wait()
        finally:
            self._changed.changes = UNCHANGED
            loop.set_limits(limits)
            supervisor.heat_W += before_W
        return self._run()

    def _ticks(self, lasts_s: float) -> int:
        """Length of a hold [ticks]."""
        return max(LEAST_TICKS, round(lasts_s * self.bench.rate_Hz))

    def _segment(self, lasts_s: float = HOLD_S, falls: bool = False, expected_N: float | None = None) -> Segment:
        """Segment of one hold."""
        ticks = self._ticks(lasts_s)
        if expected_N is not None:
            drive = _LevelDrive(self.level_V)
            return Segment("proof", TableReference(np.full(ticks, expected_N)), drive, None)
        values = np.full(ticks, self.level_V)
        if falls:
            safe_V = self.bench.limits.voltage_safe_V
            values[ticks // 2 :] = np.linspace(
                self.level_V, safe_V + FALLEN * (self.level_V - safe_V), ticks - ticks // 2
            )
        return Segment("proof", TableReference(values), DirectDrive(), None, follows_force=False)

    def withhold_commands(self) -> tuple[float, float, float]:
        """Hold the level, then only read, until the device has brought its output to rest.

        Returns
        -------
        tuple
            Time until the output falls [ms], distance of the output from rest at the end [V], time until rest [ms].

        Raises
        ------
        CheckFailedError
            A precondition of arming fails, the level is not reached, or the test was interrupted.
        """
        loop, held = self._loop, 0
        self._arm(self._segment())
        while loop.supervisor.driving and held < self._ticks(HOLD_S) // 2:
            loop.run_tick()
            held += self.level_reached()
            loop.wait()
        if not self.level_reached():
            raise CheckFailedError(f"proof: {CAUSE_TEXT[loop.supervisor.cause]}")
        fall = self._watch_fall()
        while loop.supervisor.driving:  # the first tick after the pause finds what the device has done
            loop.run_tick()
            loop.wait()
        return fall

    def _watch_fall(self) -> tuple[float, float, float]:
        """Read until the output is at rest, or no longer than the watchdog and a slow fall need."""
        limits, within_V = self.bench.limits, self.bench.arming.readback_within_V
        begun_ns, falls_ms, rest_ms = self._clock.now_ns(), inf, inf
        before_V = left_V = abs(self.link.reading.voltage_readback_V - limits.voltage_safe_V)
        most_ns = round(1e6 * (limits.device_watchdog_ms + limits.comm_loss_ms) + 1e9 * TRY_S)
        while (now_ns := self._clock.now_ns()) - begun_ns < most_ns and not self.interrupted and rest_ms == inf:
            if self.link.poll() == ExchangeResult.OK:
                left_V = abs(self.link.reading.voltage_readback_V - limits.voltage_safe_V)
                if falls_ms == inf and left_V < 0.9 * before_V:
                    falls_ms = (now_ns - begun_ns) / 1e6
                if left_V <= min(within_V, 0.1 * before_V):
                    rest_ms = (now_ns - begun_ns) / 1e6
            self._clock.wait()
        return falls_ms, left_V, rest_ms

    def _arm(self, segment: Segment) -> None:
        """Check every precondition, then arm with the segment; the fault of an earlier step is reset at rest."""
        loop = self._loop
        loop.supervisor.reset(at_rest=loop.at_rest and loop.supervisor.state is State.FAULT)
        if self.interrupted or loop.supervisor.state is not State.DISARMED:
            raise CheckFailedError("proof: interrupted")
        check_ready_to_arm(self.bench, self.link)
        self._reader.read()
        loop.arm(segment)

    def _run(self) -> Run:
        """Rows since the arming, and their end."""
        dropped = self._reader.dropped
        rows = self._reader.read()
        if self._reader.dropped != dropped:
            raise CheckFailedError(
                f"proof: daemon.ring_seconds is {self.bench.daemon.ring_seconds:g}, shorter than a step; raise it"
            )
        return Run(rows, self._loop.supervisor.fault)
