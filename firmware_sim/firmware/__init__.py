"""The firmware of the emulated device: registers, command, watchdog, Modbus requests, ASCII lines."""
