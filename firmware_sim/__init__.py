"""The emulated piezo bench: amplifier, stack, mechanics and load cell, with Modbus and serial firmware in front."""
