"""Keep a fixed rate against absolute deadlines; a missed tick is skipped and counted, never replayed."""

import time
from typing import Protocol


class RateKeeper(Protocol):
    """What the loop asks of a clock."""

    tick: int
    missed: int
    missed_in_a_row: int
    lateness_ns: int

    def start(self) -> None:
        """Take the first deadline: now."""
        ...

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        ...

    def wait(self) -> None:
        """Sleep until the next deadline that is still ahead."""
        ...


class RealRateKeeper:
    """Deadlines of the monotonic clock: sleep until one comes, and say how late the wake-up was.

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
        """Take the first deadline: now."""
        self._deadline_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        """Monotonic time [ns], a suspended machine's included: what it slept through is a pause like any other."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

    def wait(self) -> None:
        """Sleep until the next deadline that is still ahead; `tick` counts the skipped ones too."""
        deadline = self._deadline_ns + self._period_ns
        late_ns = time.monotonic_ns() - deadline
        if late_ns >= 0:
            skipped = late_ns // self._period_ns + 1
            deadline += skipped * self._period_ns
            self.missed += skipped
            self.missed_in_a_row += 1
            self.tick += skipped
        else:
            self.missed_in_a_row = 0
        time.sleep(max(0, deadline - time.monotonic_ns()) * 1e-9)
        self.lateness_ns = time.monotonic_ns() - deadline
        self._deadline_ns = deadline
        self.tick += 1


class VirtualRateKeeper:
    """Time that advances by one period a tick without waiting, for an emulated bench that does the same."""

    __slots__ = ("_period_ns", "lateness_ns", "missed", "missed_in_a_row", "tick")

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * 1e9)
        self.tick = 0
        self.missed = 0
        self.missed_in_a_row = 0
        self.lateness_ns = 0

    def start(self) -> None:
        """Nothing to take."""

    def now_ns(self) -> int:
        """Virtual time [ns]."""
        return self.tick * self._period_ns

    def wait(self) -> None:
        """The next tick is now."""
        self.tick += 1
