"""Random sequences of commands, reloads, kills, datagrams, device faults and clients against the whole service.

    python -m tests.stateful [--sequences N] [--steps N] [--seed N] [--seconds S]

The service runs as its own processes at real-time priority, against an emulated amplifier behind a proxy. Each sequence
is judged at the output of that amplifier, and by what its clients are answered.
"""
