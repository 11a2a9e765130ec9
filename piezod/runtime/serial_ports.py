"""Serial ports."""

import serial

open_port = serial.Serial
"""Open a serial port, as `serial.Serial`."""
