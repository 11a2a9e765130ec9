"""The door to the operating system: every clock, socket, descriptor, signal, process, thread and random number.

The rooms `control`, `transport`, `session`, `recorder`, `daemon` and `bridge` call the outside through these modules
only, by `module.function(...)`. Each name is a function of the standard library, so a call costs no more than before.
The simulation of the whole service (`tests/simulation/`) replaces the names, and runs this program in virtual time.
"""
