"""The whole service in virtual time: one seed, one history.

The program that runs is the real one: parent, control process, recorder and clients, with their frames, files and
signals. `machine.py` is the machine below it: time, processes, and the order in which they run. `sockets.py`,
`spawning.py` and `event_loop.py` are its devices, behind `piezod/runtime/`. `amplifier.py` is the emulated bench with
a judge at every physics step. `history.py` draws what happens from the seed.
"""
