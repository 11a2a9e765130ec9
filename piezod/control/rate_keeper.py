"""The clock of the loop: absolute deadlines at a fixed rate. A missed tick is skipped and counted, never replayed."""

from typing import Protocol

from piezod.runtime import clock

NO_DEADLINE_NS = 1 << 62  # time left where ticks have no deadlines


class RateKeeper(Protocol):
    """Clock of the loop.

    Attributes
    ----------
    tick
        Number of the current tick; skipped ticks count.
    missed
        Number of ticks skipped since the start.
    missed_in_a_row
        Number of waits in a row that skipped a tick.
    lateness_ns
        Delay of the last wake-up after its deadline [ns].
    """

    tick: int
    missed: int
    missed_in_a_row: int
    lateness_ns: int

    def start(self) -> None:
        """Set the first deadline to the present time."""
        ...

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        ...

    def time_left_ns(self) -> int:
        """Time until the next deadline [ns]; negative after it."""
        ...

    def sleep_until_before(self, before_ns: int) -> None:
        """Sleep until `before_ns` [ns] before the next deadline; returns at once where that has passed."""
        ...

    def wait(self) -> None:
        """Sleep until the next deadline in the future."""
        ...


class RealRateKeeper:
    """Deadlines of the monotonic clock.

    Parameters
    ----------
    period_s
        Tick period [s].
    """

    __slots__ = ("_deadline_ns", "_period_ns", "lateness_ns", "missed", "missed_in_a_row", "tick")

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * 1e9)
        self._deadline_ns = 0
        self.tick = 0
        self.missed = 0
        self.missed_in_a_row = 0
        self.lateness_ns = 0

    def start(self) -> None:
        """Set the first deadline to the present time."""
        self._deadline_ns = clock.monotonic_ns()

    def now_ns(self) -> int:
        """Monotonic time [ns]; it includes the time in which the machine was suspended."""
        return clock.boot_ns()

    def time_left_ns(self) -> int:
        """Time until the next deadline [ns]; negative after it."""
        return self._deadline_ns + self._period_ns - clock.monotonic_ns()

    def sleep_until_before(self, before_ns: int) -> None:
        """Sleep until `before_ns` [ns] before the next deadline; returns at once where that has passed."""
        early_ns = self.time_left_ns() - before_ns
        if early_ns > 0:
            clock.sleep(1e-9 * early_ns)

    def wait(self) -> None:
        """Sleep until the next deadline in the future; `tick` counts the skipped deadlines too."""
        deadline = self._deadline_ns + self._period_ns
        late_ns = clock.monotonic_ns() - deadline
        if late_ns >= 0:
            skipped = late_ns // self._period_ns + 1
            deadline += skipped * self._period_ns
            self.missed += skipped
            self.missed_in_a_row += 1
            self.tick += skipped
        else:
            self.missed_in_a_row = 0
        clock.sleep(max(0, deadline - clock.monotonic_ns()) * 1e-9)
        self.lateness_ns = clock.monotonic_ns() - deadline
        self._deadline_ns = deadline
        self.tick += 1


class VirtualRateKeeper:
    """Virtual time that advances by one period a tick without waiting, for an emulated bench in virtual time.

    Parameters
    ----------
    period_s
        Tick period [s].
    """

    __slots__ = ("_period_ns", "lateness_ns", "missed", "missed_in_a_row", "tick")

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * 1e9)
        self.tick = 0
        self.missed = 0
        self.missed_in_a_row = 0
        self.lateness_ns = 0

    def start(self) -> None:
        """No effect: virtual time has no deadlines."""

    def now_ns(self) -> int:
        """Virtual time [ns]."""
        return self.tick * self._period_ns

    def time_left_ns(self) -> int:
        """`NO_DEADLINE_NS`: an exchange may take any time."""
        return NO_DEADLINE_NS

    def sleep_until_before(self, before_ns: int) -> None:
        """No effect: virtual time has no deadlines."""

    def wait(self) -> None:
        """Advance to the next tick at once."""
        self.tick += 1
