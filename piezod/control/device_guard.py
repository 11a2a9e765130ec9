"""Supervision of the device while voltages are written: it must stay the configured device with its settings.

Identity, map version and the watchdog of the device were checked before arming. Another client, a restart or an
exchanged device can change them afterwards. The guard reads them again in turn, in the free time at the end of a tick.

A second master writes at any time of a tick, and the next exchange covers its voltage. The guard therefore reads the
command of the device in the middle of a tick, between two exchanges.
"""

from math import inf

from piezod.control.rate_keeper import NO_DEADLINE_NS, RateKeeper
from piezod.control.states import Cause
from piezod.control.supervisor import Supervisor
from piezod.transport import ExchangeResult, Link

TURN_NS = 500_000_000  # time in which every register is read once, where the ticks leave room [ns]
OVERDUE_NS = 400_000_000
"""Delay of a turn after which its reads no longer wait for room; a tick may then be missed [ns]."""
RETRY_NS = 50_000_000  # pause after a failed read [ns]
UNCONFIRMED_NS = 3_000_000_000  # longest time without a successful read, while the exchanges succeed [ns]
MARGIN_NS = 100_000  # free time that is needed besides 1.25 times the duration of the exchange [ns]
COMPARE_NS = 50_000_000
"""Time between two comparisons of the command [ns]: the default of `limits.readback_trip_ms`, after which a foreign
voltage that the readback shows is found. It costs 20 exchanges a second, in free time."""

_OK, _UNVERIFIED = int(ExchangeResult.OK), int(ExchangeResult.UNVERIFIED)  # plain integers compare faster


class DeviceGuard:
    """Reads one register at a time, and trips when the device is another or has lost a setting.

    Parameters
    ----------
    rate_keeper
        Clock of the loop.
    """

    __slots__ = (
        "_at_once",
        "_clock",
        "_compare_ns",
        "_compared_ns",
        "_confirmed_ns",
        "_done_ns",
        "_due_ns",
        "_exchange_ns",
        "_link",
        "_supervisor",
    )

    def __init__(self, link: Link, supervisor: Supervisor, rate_keeper: RateKeeper) -> None:
        self._link, self._supervisor, self._clock = link, supervisor, rate_keeper
        self._due_ns = self._confirmed_ns = 0
        self._at_once = 0  # registers still to read without a pause, after a failed exchange
        self._done_ns = self._exchange_ns = 0  # end and duration of the last good exchange; 0: it failed
        self._compare_ns = self._compared_ns = 0  # when the command is compared again, and was compared

    def evaluate(self, result: int) -> None:
        """Trip where a result names another device or a changed setting; the cause has its name."""
        if result > _UNVERIFIED:
            self._supervisor.trip(Cause[ExchangeResult(result).name])

    def end_tick(self, result: int, begun_ns: int, done_ns: int) -> None:
        """Read the next register when it is due and the rest of the tick is long enough.

        Parameters
        ----------
        result
            Result of the exchange of this tick. After a failure every register is due at once: the device may have
            restarted.
        begun_ns, done_ns
            Begin and end of the exchange [ns].
        """
        self._done_ns, self._exchange_ns = done_ns, done_ns - begun_ns if result == _OK else 0
        if done_ns < self._due_ns and result == _OK:
            return
        if not self._supervisor.driving:
            self._due_ns = self._confirmed_ns = done_ns
            return
        if result != _OK:
            self._due_ns = min(self._due_ns, done_ns)
            self._at_once = self._link.supervised
            return
        count = self._link.supervised
        if count == 0:
            self._due_ns = done_ns + TURN_NS
            return
        free_ns = self._clock.time_left_ns()
        overdue = done_ns - self._due_ns > OVERDUE_NS // count
        if free_ns < (done_ns - begun_ns) * 5 // 4 + MARGIN_NS and not overdue:
            return
        self._read(inf if overdue or free_ns >= NO_DEADLINE_NS else 1e-9 * free_ns, TURN_NS // count, done_ns)

    def compare_command(self) -> int:
        """Halfway to the next tick, compare the command of the device with the last one written, when that is due.

        Returns
        -------
        int
            Result of the comparison; OK where it was not due, or where the tick leaves no room.
        """
        now_ns, exchange_ns = self._done_ns, self._exchange_ns
        if now_ns < self._compare_ns or not self._link.holds_command:
            return _OK
        if not self._supervisor.driving or not self._compared_ns:
            self._compared_ns = now_ns
            return _OK
        needed_ns, free_ns = exchange_ns * 5 // 4 + MARGIN_NS, self._clock.time_left_ns()
        overdue = now_ns - self._compared_ns > OVERDUE_NS
        wakes_late = 4 * self._clock.lateness_ns > free_ns  # it may again, and another wake-up would cost the next tick
        if not exchange_ns or ((free_ns < needed_ns or wakes_late) and not overdue):
            return _OK
        if free_ns < NO_DEADLINE_NS:
            self._clock.sleep_until_before(max(needed_ns, free_ns // 2))  # half of it is left for a late wake-up
            if self._clock.time_left_ns() < needed_ns and not overdue:
                return _OK
        result = self._link.compare_command()
        self._compare_ns = now_ns + COMPARE_NS
        if result == _OK:
            self._compared_ns = now_ns
        elif result <= _UNVERIFIED and now_ns - self._compared_ns > UNCONFIRMED_NS:
            return int(ExchangeResult.SETTING_CHANGED)
        return result

    def _read(self, time_limit_s: float, interval_ns: int, now_ns: int) -> None:
        """Read one register and evaluate the result."""
        found = self._link.supervise(time_limit_s)
        if found == _OK:
            self._at_once = max(self._at_once - 1, 0)
            self._confirmed_ns, self._due_ns = now_ns, now_ns + (0 if self._at_once else interval_ns)
            return
        self._due_ns = now_ns + RETRY_NS
        self.evaluate(found)
        if now_ns - self._confirmed_ns > UNCONFIRMED_NS:
            self._supervisor.trip(Cause.SETTING_CHANGED)
