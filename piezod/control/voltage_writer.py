"""The voltage writer: the one place that writes a voltage to the link.

After a failed exchange, or a pause, it reads the device before it writes. A device that has restarted, or whose
watchdog has tripped, drives its output by itself. A voltage written then would be a jump.
"""

from math import inf

from piezod.config import LimitsConfig
from piezod.control.limits import Limiter
from piezod.control.rate_keeper import RateKeeper
from piezod.control.states import Cause
from piezod.control.supervisor import Supervisor
from piezod.transport import ACKNOWLEDGED, ExchangeResult, Link
from piezod.transport.status import STATUS_WATCHDOG

READ_FIRST_S = 0.05
"""Tick period from which each tick reads before it writes [s]: a device may restart between two ticks."""


class VoltageWriter:
    """Limits the planned voltages, writes them, and keeps account of what the device has acknowledged.

    Parameters
    ----------
    supervisor
        Supervisor; it trips when the device has taken over its output.
    rate_keeper
        Clock of the loop.
    limits
        Limits of communication and device watchdog.
    dt_s
        Tick period [s].
    readback_within_V
        Largest difference between output and readback [V].
    watchdog_in_status
        Whether the device's status has the bit of its watchdog.

    Attributes
    ----------
    output_uncertain
        True when the device has not acknowledged the last voltage.
    """

    def __init__(
        self,
        link: Link,
        limiter: Limiter,
        supervisor: Supervisor,
        rate_keeper: RateKeeper,
        limits: LimitsConfig,
        dt_s: float,
        *,
        readback_within_V: float = inf,
        watchdog_in_status: bool = True,
    ) -> None:
        self._link, self._limiter = link, limiter
        self._supervisor, self._clock = supervisor, rate_keeper
        self._dt_ns = round(dt_s * 1e9)
        self._reads_first = dt_s >= READ_FIRST_S
        self._readback_within_V = readback_within_V
        self._watchdog_in_status = watchdog_in_status
        self._acknowledged_ns = 0
        self._sent_ns = -self._dt_ns
        self.output_uncertain = False
        self.set_limits(limits)

    def set_limits(self, limits: LimitsConfig) -> None:
        """Replace the limits; the account of the output stays."""
        self._safe_V = limits.voltage_safe_V
        self._watchdog_ns = round(1e6 * limits.device_watchdog_ms)
        self._verify_after_ns = self._watchdog_ns // 2 or round(1e6 * limits.comm_loss_ms)
        margin_ns = max(2 * self._dt_ns, self._watchdog_ns // 10)
        self._too_late_ns = self._watchdog_ns - margin_ns if self._watchdog_ns else 1 << 62

    def start_from(self, output_V: float) -> None:
        """Begin at an output of `output_V` [V], which was read back."""
        self._limiter.applied_V = output_V
        now_ns = self._clock.now_ns()
        self._acknowledged_ns = now_ns
        self._sent_ns = now_ns - self._dt_ns
        self.output_uncertain = False

    def write(self, planned_V: float, begun_ns: int, change_V: float = inf) -> ExchangeResult:
        """Write a voltage; read the device first when its output is uncertain.

        Parameters
        ----------
        planned_V
            Planned voltage [V].
        begun_ns
            Monotonic time at the begin of the tick [ns].
        change_V
            Largest change in this tick [V], where it is smaller than the slew limit.
        """
        if self.output_uncertain or begun_ns - self._acknowledged_ns >= self._verify_after_ns:
            return self._verify_and_write(planned_V, begun_ns, change_V)
        if self._reads_first:
            result = self._verify()
            if result != ExchangeResult.OK or not self._supervisor.driving:
                return result
        result = self._write(planned_V, begun_ns, change_V)
        if self._reads_first and result == ExchangeResult.HEARTBEAT_STOOD:
            return ExchangeResult.OK  # no new sample since `_verify`, whose reading is good
        return result

    def _write(self, planned_V: float, begun_ns: int, change_V: float) -> ExchangeResult:
        """Limit and write, unless the process has paused since the tick began: the device may have taken over."""
        limiter, link = self._limiter, self._link
        paused_ns = self._clock.now_ns() - begun_ns
        if paused_ns >= self._verify_after_ns:
            self.output_uncertain = True
            self._supervisor.check_pause(paused_ns)
            return ExchangeResult.TIMEOUT
        elapsed_ns = begun_ns - self._sent_ns
        share = 1.0 if 10 * elapsed_ns >= 9 * self._dt_ns else elapsed_ns / self._dt_ns
        result = link.exchange(limiter.limit(planned_V, change_V, share))
        self._sent_ns = begun_ns
        self.output_uncertain = not (result in ACKNOWLEDGED or link.output_confirmed)
        if self.output_uncertain:
            limiter.perhaps_sent(link.written_V)
        else:
            limiter.acknowledged(link.written_V)
            self._acknowledged_ns = begun_ns
        return result

    def _verify_and_write(self, planned_V: float, begun_ns: int, change_V: float) -> ExchangeResult:
        """Write only if the device still drives its output as commanded, and will until the command arrives."""
        result = self._verify()
        silent_ns = self._clock.now_ns() - self._acknowledged_ns
        self.output_uncertain = True
        if result != ExchangeResult.OK or not self._supervisor.driving or silent_ns >= self._too_late_ns:
            return result
        result = self._write(planned_V, begun_ns, change_V)
        if result == ExchangeResult.HEARTBEAT_STOOD:  # no new sample since `_verify`, whose reading is good
            return ExchangeResult.OK
        return result

    def name_restart(self) -> None:
        """Trip where the device has restarted or its watchdog has tripped: it then holds another command too."""
        if self._verify() is ExchangeResult.ECHO_MISMATCH:
            self._link.accept_foreign_command()
            self._verify()

    def _verify(self) -> ExchangeResult:
        """Read the device; trip when it has taken over its output."""
        reading, supervisor = self._link.reading, self._supervisor
        heartbeat = reading.heartbeat
        result = self._link.poll()
        if result != ExchangeResult.OK:
            return result
        silent = 0 < self._watchdog_ns <= self._clock.now_ns() - self._acknowledged_ns
        if silent and (not self._watchdog_in_status or reading.status & STATUS_WATCHDOG):
            supervisor.trip(Cause.DEVICE_WATCHDOG)
        elif (reading.heartbeat - heartbeat) & 0xFFFF >= 0x8000 or self._has_dropped(reading.voltage_readback_V):
            supervisor.trip(Cause.DEVICE_RESTARTED)
        return result

    def _has_dropped(self, readback_V: float) -> bool:
        """Whether the output is nearer to rest than any voltage sent: the device has restarted, or is off."""
        limiter, safe_V = self._limiter, self._safe_V
        least_V = min(abs(limiter.lowest_sent_V - safe_V), abs(limiter.highest_sent_V - safe_V))
        return abs(readback_V - safe_V) < least_V - self._readback_within_V  # False for nan
