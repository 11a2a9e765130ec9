"""The physics of the emulated bench: amplifier, stack, mechanics, load cell."""
