"""Replies of a device with an ASCII line protocol: patterns, and the values in their named groups."""

import re
from collections.abc import Mapping
from math import isfinite

from piezod.config.checked import shortened
from piezod.config.link import LineCommand
from piezod.errors import ConfigurationError
from piezod.transport.link import ExchangeResult
from piezod.transport.tick_values import COUNTERS, QUANTITIES

ROLES = {  # named group -> role
    "force_N": "force",
    "voltage_readback_V": "voltage_readback",
    "temperature_C": "temperature",
    "reference_N": "reference",
    "heartbeat": "heartbeat",
    "command_echo": "command_echo",
    "status": "status",
}


class ReplyFields:
    """The quantities and counters in the reply to `measure`.

    Parameters
    ----------
    pattern
        Compiled reply pattern with groups named as in `ROLES`; None: the device is not read.

    Attributes
    ----------
    roles
        Roles of the named groups.
    """

    __slots__ = ("_counters", "_quantities", "roles")

    def __init__(self, pattern: re.Pattern[bytes] | None) -> None:
        names = tuple(pattern.groupindex) if pattern is not None else ()
        self.roles = frozenset(ROLES[name] for name in names)
        self._quantities = tuple((name, QUANTITIES[ROLES[name]]) for name in names if ROLES[name] in QUANTITIES)
        self._counters = tuple((name, COUNTERS[ROLES[name]]) for name in names if ROLES[name] in COUNTERS)

    def decode(self, match: re.Match[bytes], values: list[float], counters: list[int]) -> ExchangeResult:
        """Write the numbers of a reply into `values` and `counters`, by slot."""
        try:
            for name, slot in self._quantities:
                value = decimal(match[name])
                if not isfinite(value):
                    return ExchangeResult.NOT_FINITE
                values[slot] = value
            for name, slot in self._counters:
                counters[slot] = _integer(match[name])
        except (TypeError, ValueError):
            return ExchangeResult.MALFORMED
        return ExchangeResult.OK


def compile_reply(
    command: LineCommand, where: str, groups: Mapping[str, object] | None = None
) -> re.Pattern[bytes] | None:
    """Compiled pattern for the whole reply; None: the command has no reply.

    Parameters
    ----------
    command
        Line and reply pattern.
    where
        Key in the configuration, for messages.
    groups
        Permitted names of groups; None: no groups.

    Raises
    ------
    ConfigurationError
        The pattern is not a regular expression, or a group is not in `groups`.
    """
    if command.reply is None:
        return None
    try:
        pattern = re.compile(command.reply.encode("ascii"))
    except (re.error, UnicodeEncodeError) as error:
        raise ConfigurationError(
            f"{where}.reply is {shortened(command.reply)}, must be a regular expression: {str(error)[:100]}"
        ) from error
    unknown = set(pattern.groupindex) - set(groups or ())
    if unknown:
        allowed = ", ".join(groups or ()) or "none"
        raise ConfigurationError(f"{where}.reply names the group {shortened(min(unknown))}, must be one of: {allowed}")
    return pattern


def decimal(text: bytes) -> float:
    """The number in a field; raises ValueError, also for the underscores that Python accepts."""
    if b"_" in text:
        raise ValueError
    return float(text)


def _integer(text: bytes) -> int:
    """The integer in a field; raises ValueError, also for the underscores that Python accepts."""
    if b"_" in text:
        raise ValueError
    return int(text)
