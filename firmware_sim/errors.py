"""The deliberate errors of the emulated bench.

EmulatorError
    ConfigurationError      a file holds an invalid value
    PortBusyError           another program holds the port
    RefusedError            the firmware refuses a request; holds the Modbus exception code
"""


class EmulatorError(Exception):
    """Base of every deliberate error of the emulated bench."""


class ConfigurationError(EmulatorError):
    """Invalid configuration; one line with file, line, key, value and limit."""


class PortBusyError(EmulatorError):
    """Another program holds the address."""


class RefusedError(EmulatorError):
    """A request that the firmware answers with a Modbus exception.

    Parameters
    ----------
    code
        Modbus exception code: 1 function, 2 address, 3 value.
    reason
        Reason, for the log.
    """

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code
