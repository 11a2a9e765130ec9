"""All deliberate errors of piezod, with the exit code of the command.

    PiezodError                1   General failure with a remedy.
    |- CheckFailedError        1   A check, a comparison or a demo failed.
    |- UsageError              2   The arguments do not fit together.
    |- TemporaryError         75   A resource is not ready; try again later.
    |  |- UnreachableError    75   No device or daemon answers at the address or port.
    |  `- BusyError           75   Another process or client uses the device, the port or the lock.
    `- ConfigurationError     78   A file contains an invalid value.
       |- ModelError          78   A model cannot be loaded or inverted.
       |- IdentityError       78   The connected device is not the configured device.
       `- RecordingError      78   A recording cannot be read or used.

A message is one line: what, where, the value, the limit, what to do. Text from a file or a device may contain control
characters, such as line ends and escape sequences. The message shows them as escapes.
"""


class PiezodError(Exception):
    """A failure with a remedy for the user; base of all deliberate errors."""

    exit_code = 1

    def __str__(self) -> str:
        """The message on one line, with printable characters only."""
        text = super().__str__()
        return text if text.isprintable() else "".join(map(_escaped, text))


class CheckFailedError(PiezodError):
    """A check, a comparison or a demo failed."""


class UsageError(PiezodError):
    """The arguments do not fit together."""

    exit_code = 2


class TemporaryError(PiezodError):
    """A resource is not ready; the same command may succeed later."""

    exit_code = 75


class UnreachableError(TemporaryError):
    """No device or daemon answers at the address or port."""


class BusyError(TemporaryError):
    """Another process or client uses the device, the port or the lock."""


class ConfigurationError(PiezodError):
    """A file contains an invalid value."""

    exit_code = 78


class ModelError(ConfigurationError):
    """A model cannot be loaded or inverted."""


class IdentityError(ConfigurationError):
    """The connected device is not the configured device."""


class RecordingError(ConfigurationError):
    """A recording cannot be read or used."""


def system_error_text(error: OSError) -> str:
    """Make one line of an error of the system that was not expected where it occurred.

    Parameters
    ----------
    error
        The error; its file name is part of the line.
    """
    place = "" if error.filename is None else f"{error.filename}: "
    return f"{place}{error.strerror or type(error).__name__}: the system refused it; free the resource and try again"


def _escaped(character: str) -> str:
    return character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
