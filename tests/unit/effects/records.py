"""Records that the tests of effects drive."""

from dataclasses import replace

import numpy as np

from piezod.effects import EFFECTS, Context


def over(signal, dt_s, **changed):
    """Context of a record whose voltage is the signal itself."""
    made = Context(dt_s, np.arange(signal.size) * dt_s, signal, signal, signal.size * dt_s, force_span_N=100.0)
    return replace(made, **changed)


def forward(name, signal, dt_s, values, **changed):
    """What an effect makes of a signal; nuisances that are not given stay as the effect has them."""
    return EFFECTS[name].forward(signal, over(signal, dt_s, **changed), values)


def triangle(frequency_Hz, dt_s, periods, peak=1.0):
    """0 to peak and back, `periods` times; one period is a whole number of samples."""
    phase = np.arange(round(periods / (frequency_Hz * dt_s)) + 1) * frequency_Hz * dt_s
    return peak * (1.0 - np.abs(1.0 - 2.0 * (phase % 1.0)))


def opening(x, y, samples_a_period):
    """Largest distance of the branches of the last loop at one x, over the range of x.

    Source: piezod/operators/README.md, "Maximum hysteresis".
    """
    half = samples_a_period // 2
    up, down = y[-samples_a_period - 1 : -half], y[-half - 1 :][::-1]
    return np.abs(down - up).max() / np.ptp(x)
