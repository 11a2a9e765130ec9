"""Every error that piezod raises on purpose, and the exit code it ends the command with.

    PiezodError
    |- CheckFailedError        1   a check, a comparison or a demo did not reach its limit
    |- UsageError              2   arguments that do not go together
    |- TemporaryError         75   try again later
    |  |- UnreachableError         nobody answers at that address or port
    |  `- BusyError                somebody else holds the device, the port or the lock
    `- ConfigurationError     78   a file says something impossible
       |- ModelError               a model that cannot be loaded or inverted
       |- IdentityError            the device is not the one the configuration names
       `- RecordingError           a recording that cannot be used

A message is one line: what, where, the value, the limit, what to do. Signs that a terminal or a log would obey (line
ends, escape sequences) may come from a file or a device; they are shown as escapes.
"""


class PiezodError(Exception):
    """A failure that the user can do something about."""

    exit_code = 1

    def __str__(self) -> str:
        """The message on one line, every sign printable."""
        text = super().__str__()
        return text if text.isprintable() else "".join(map(_shown, text))


class CheckFailedError(PiezodError):
    """A check did not reach its limit."""


class UsageError(PiezodError):
    """Arguments that do not go together."""

    exit_code = 2


class TemporaryError(PiezodError):
    """Something outside is not ready; the same command may work later."""

    exit_code = 75


class UnreachableError(TemporaryError):
    """Nobody answers at that address or port."""


class BusyError(TemporaryError):
    """Somebody else holds the device, the port or the lock."""


class ConfigurationError(PiezodError):
    """A file says something impossible."""

    exit_code = 78


class ModelError(ConfigurationError):
    """A model that cannot be loaded or inverted."""


class IdentityError(ConfigurationError):
    """The device that answers is not the one the configuration names."""


class RecordingError(ConfigurationError):
    """A recording that cannot be used."""


def _shown(sign: str) -> str:
    return sign if sign.isprintable() else sign.encode("unicode_escape").decode("ascii")
