"""The deliberate errors of the emulated bench.

EmulatorError
    ConfigurationError      a file says something that cannot be
    PortBusyError           another program holds the port
    RefusedError            the firmware refuses a request (carries the Modbus exception code)
"""


class EmulatorError(Exception):
    """Anything that the emulated bench refuses on purpose."""


class ConfigurationError(EmulatorError):
    """One line: file, line, key, value, limit."""


class PortBusyError(EmulatorError):
    """The address to serve on is taken."""


class RefusedError(EmulatorError):
    """A request that the firmware answers with a Modbus exception.

    Parameters
    ----------
    code
        The Modbus exception code: 1 function, 2 address, 3 value.
    reason
        For the log.
    """

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code
