"""The delay between the force and its reading, as a step of the chain: a ring of the last forces."""

import math

import numpy as np

from piezod.effects.tick import Memory, Tick

TICKS, SIZE, COUNT, RING = range(4)  # memory: delay [ticks], numbers of the ring, ticks so far; then the ring


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    count, size = int(own[COUNT]), int(own[SIZE])
    own[RING + count % size] = force_N
    own[COUNT] += 1.0
    whole = int(own[TICKS])
    part = own[TICKS] - whole
    return (1.0 - part) * own[RING + (count - whole) % size] + part * own[RING + (count - whole - 1) % size]


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    own[COUNT] = 0.0
    for k in range(RING, RING + int(own[SIZE])):
        own[k] = force_N
    return force_N


def delay_line(ticks: float) -> Tick:
    """Step of a delay.

    Parameters
    ----------
    ticks
        Delay [ticks], at least 0.
    """
    size = math.ceil(ticks) + 2
    memory = np.concatenate(([ticks, size, 0.0], np.zeros(size)))
    return Tick(lambda _values, _setting: memory, _advance, settle=_settle)
