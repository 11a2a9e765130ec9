"""The firmware of the emulated device: registers, commands, watchdog, protocols."""
