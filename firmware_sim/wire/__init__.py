"""The connections of the emulated device: Modbus TCP, Modbus RTU, ASCII lines, pseudo-terminals."""
