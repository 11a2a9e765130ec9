"""What must not change on a device with an ASCII line protocol: its identity and the time of its watchdog."""

import re
from collections.abc import Callable
from math import isfinite, nan

from piezod.transport.line_reply import decimal
from piezod.transport.line_template import LineTemplate
from piezod.transport.link import ExchangeResult

WATCHDOG = "watchdog_ms"

Pattern = re.Pattern[bytes] | None
ExchangeLine = Callable[[bytes, Pattern, float], tuple[ExchangeResult, "re.Match[bytes] | None"]]

_OK = ExchangeResult.OK


class LineGuard:
    """Compares the identity at each opening of the port, and both in turn while voltages are written.

    Such a device has no register to read the watchdog from. Its time is therefore sent again, and compared with the
    acknowledgement where the reply has one.

    Parameters
    ----------
    exchange_line
        Sends a line and matches its reply until a deadline on the monotonic clock.
    identity
        Line that asks for the identity, and the pattern of its reply; an empty line: none is configured.
    watchdog
        Line that sets the watchdog, and the pattern of its reply; None: the device has none.

    Attributes
    ----------
    watchdog_ms
        Time that the device has acknowledged [ms]; nan before the first.
    verified
        Number of the opening of the port at which the identity was compared; -1 before the first.
    """

    __slots__ = ("_damaged", "_exchange_line", "_identity", "_next", "_watchdog", "verified", "watchdog_ms")

    def __init__(
        self,
        exchange_line: ExchangeLine,
        identity: tuple[bytes, Pattern],
        watchdog: tuple[LineTemplate | None, Pattern],
    ) -> None:
        self._exchange_line, self._identity, self._watchdog = exchange_line, identity, watchdog
        self._damaged = False
        self._next = 0
        self.verified = -1
        self.watchdog_ms = nan

    @property
    def count(self) -> int:
        """Number of calls of `check_next` in one turn."""
        return bool(self._identity[0]) + isfinite(self.watchdog_ms)

    def verify(self, generation: int, deadline_s: float) -> ExchangeResult:
        """Compare the identity at a new opening of the port, then set the watchdog again.

        Parameters
        ----------
        generation
            Number of the opening of the port.
        deadline_s
            Time limit on the monotonic clock [s].
        """
        result = self._compare_identity(deadline_s)
        if result is _OK and isfinite(self.watchdog_ms):
            result = self._set_watchdog(deadline_s)
        if result is _OK:
            self.verified = generation
        return result

    def check_next(self, deadline_s: float) -> ExchangeResult:
        """Compare the identity, or set the watchdog again, in turn."""
        has_watchdog = isfinite(self.watchdog_ms)
        if has_watchdog and (self._next % 2 == 0 or not self._identity[0]):
            result = self._set_watchdog(deadline_s)
        else:
            result = self._compare_identity(deadline_s)
        if result is _OK:
            self._next += 1
        return result

    def _compare_identity(self, deadline_s: float) -> ExchangeResult:
        """Compare the reply to `identity`; one damaged reply is MALFORMED, two in a row are WRONG_DEVICE."""
        line, pattern = self._identity
        if not line:
            return _OK
        result, _ = self._exchange_line(line, pattern, deadline_s)
        before, self._damaged = self._damaged, result is ExchangeResult.MALFORMED
        return ExchangeResult.WRONG_DEVICE if before and self._damaged else result

    def _set_watchdog(self, deadline_s: float) -> ExchangeResult:
        template, pattern = self._watchdog
        if template is None:
            return _OK
        line, written_ms = template.fill(self.watchdog_ms)
        result, match = self._exchange_line(line, pattern, deadline_s)
        if result is not _OK or match is None or WATCHDOG not in match.re.groupindex:
            return result
        try:
            return _OK if decimal(match[WATCHDOG]) == written_ms else ExchangeResult.SETTING_CHANGED
        except (TypeError, ValueError):
            return ExchangeResult.MALFORMED
