"""Lines to a device with an ASCII line protocol: with one number, or constant."""

import re
from math import isfinite, nan
from string import Formatter

from piezod.config.checked import shortened
from piezod.config.link import LineCommand
from piezod.errors import ConfigurationError
from piezod.transport.line_reply import compile_reply


class LineTemplate:
    """A line with one number in it, such as `SVA A {voltage_V:.3f}`.

    Parameters
    ----------
    template
        Format string for `str.format`.
    field
        Name of the number in the format string.
    terminator
        Characters at the end of the line.
    where
        Key in the configuration, for messages.

    Raises
    ------
    ConfigurationError
        The template has no field, another or several fields, or an invalid number format.
    """

    __slots__ = ("_after", "_before", "_format", "_terminator")

    def __init__(self, template: str, field: str, terminator: str, where: str) -> None:
        expected = f"must be a line with one number, such as 'SVA A {{{field}:.3f}}'"
        try:
            parts = list(Formatter().parse(template))
        except ValueError as error:
            raise ConfigurationError(f"{where} is {shortened(template)}: {error}; {expected}") from error
        fields = [(name, spec or "", conversion) for _, name, spec, conversion in parts if name is not None]
        if len(fields) != 1 or fields[0][0] != field or fields[0][2]:
            raise ConfigurationError(f"{where} is {shortened(template)}, {expected}")
        number_at = next(k for k, part in enumerate(parts) if part[1] is not None)
        self._before = "".join(part[0] for part in parts[: number_at + 1])
        self._after = "".join(part[0] for part in parts[number_at + 1 :])
        self._format = fields[0][1]
        self._terminator = terminator
        for value in (0.0, -1.5, 100.0):
            try:
                _, read_back = self.fill(value)
            except (ValueError, TypeError) as error:
                raise ConfigurationError(f"{where} is {shortened(template)}: {error}; {expected}") from error
            if abs(read_back - value) > 1.0:
                raise ConfigurationError(
                    f"{where} is {shortened(template)}: {value:g} becomes {read_back:g}; {expected}"
                )

    def fill(self, value: float) -> tuple[bytes, float]:
        """The line with its terminator, and the rounded number in it; nan if `value` is not finite."""
        if not isfinite(value):
            return b"", nan
        number = format(value, self._format)
        return f"{self._before}{number}{self._after}{self._terminator}".encode("ascii"), float(number)


def _plain_line(command: LineCommand, terminator: str, where: str) -> bytes:
    """A constant line with its terminator; raises ConfigurationError if it is not ASCII."""
    try:
        return (command.send + terminator).encode("ascii")
    except UnicodeEncodeError as error:
        raise ConfigurationError(f"{where}.send is {shortened(command.send)}, must be ASCII") from error


def template_of(
    command: LineCommand | None, field: str, terminator: str, where: str
) -> tuple[LineTemplate | None, re.Pattern[bytes] | None]:
    """Template and reply pattern of a line with a number; None where it is not configured.

    Parameters
    ----------
    command
        Line and reply of the configuration.
    field
        Name of the number in the line, and of its group in the reply.
    terminator, where
        End of the line, and key in the configuration for messages.

    Raises
    ------
    ConfigurationError
        The template or the pattern is invalid.
    """
    if command is None:
        return None, None
    return LineTemplate(command.send, field, terminator, f"{where}.send"), compile_reply(command, where, {field: 0})


def query_of(
    command: LineCommand | None, terminator: str, where: str, groups: dict[str, str] | None = None
) -> tuple[bytes, re.Pattern[bytes] | None]:
    """A constant line and its reply pattern; an empty line where it is not configured.

    Parameters
    ----------
    command
        Line and reply of the configuration.
    terminator, where
        End of the line, and key in the configuration for messages.
    groups
        Permitted names of groups in the reply; None: no groups.

    Raises
    ------
    ConfigurationError
        The line is not ASCII, or the pattern is invalid.
    """
    if command is None:
        return b"", None
    return _plain_line(command, terminator, where), compile_reply(command, where, groups)
