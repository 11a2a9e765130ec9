"""Bits of the device's `status` register; a set bit means that the named condition exists."""

STATUS_OUTPUT_ON = 1  # the output stage is on
STATUS_WATCHDOG = 2  # the device watchdog has tripped and ramps the output by itself
STATUS_CLAMPED = 4  # the output is at a limit of the device
STATUS_AMPLIFIER_FAULT = 8
STATUS_OVER_TEMPERATURE = 16
STATUS_MAINS_LOST = 32
STATUS_FAULTS = STATUS_AMPLIFIER_FAULT | STATUS_OVER_TEMPERATURE | STATUS_MAINS_LOST
