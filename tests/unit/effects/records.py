"""Signals and contexts for the tests of effects."""

from dataclasses import replace

import numpy as np

from piezod.effects import EFFECTS, Context


def over(signal, dt_s, **changed):
    """Context of a record whose voltage is the signal itself."""
    made = Context(dt_s, np.arange(signal.size) * dt_s, signal, signal, signal.size * dt_s, force_span_N=100.0)
    return replace(made, **changed)


def forward(name, signal, dt_s, values, **changed):
    """Output of an effect for a signal; a nuisance that is not given has the default of the effect."""
    return EFFECTS[name].forward(signal, over(signal, dt_s, **changed), values)


def triangle(frequency_Hz, dt_s, periods, peak=1.0):
    """From 0 to the peak and back, `periods` times; a period is a whole number of samples."""
    phase = np.arange(round(periods / (frequency_Hz * dt_s)) + 1) * frequency_Hz * dt_s
    return peak * (1.0 - np.abs(1.0 - 2.0 * (phase % 1.0)))


def opening(x, y, samples_a_period):
    """Largest vertical distance between the branches of the last loop, divided by the range of x.

    Source: piezod/operators/README.md, "Maximum hysteresis".
    """
    half = samples_a_period // 2
    up, down = y[-samples_a_period - 1 : -half], y[-half - 1 :][::-1]
    return np.abs(down - up).max() / np.ptp(x)
