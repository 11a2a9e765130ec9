"""An outside machine shakes the bench at a frequency of its own.

Forward    F + amplitude (1 + depth sin(2 pi t / period + p)) sin(2 pi f t + phase)
Inverse    refused
Signature  one line that belongs neither to the drive nor to the mains and may swell and fade; look-alikes mains_hum
           (50 or 60 Hz and harmonics), resonance (rings only behind corners)
Seat       mechanics
Valid      f from a few 1/T to half the sampling rate; swelling slower than ten periods of f
Source     derived here; machines do not run evenly, hence the breathing
"""

import math

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

TURN = 2.0 * math.pi
PHASES = (0.0, 1.57, 3.14, 4.71)


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force with the machine's, shape (N,) [N]."""
    t = context.time_s
    amplitude = values["amplitude_N"]
    line = amplitude * np.sin(TURN * values["frequency_Hz"] * t + values.get("phase_rad", 0.0))
    depth = values.get("breathing_depth", 0.0)
    if depth != 0.0:
        swell = TURN * t / values["breathing_period_s"] + values.get("breathing_phase_rad", 0.0)
        line *= 1.0 + depth * np.sin(swell)
    out: Array = signal + line
    return out


EFFECT = Effect(
    name="vibration",
    title="vibration from outside",
    seat=Seat.MECHANICS,
    form="additive",
    parameters=(
        Parameter("amplitude_N", "N", 0.0, 1e3, starts=(0.3,)),
        Parameter("frequency_Hz", "Hz", 0.1, 5000.0, starts=(10.0, 25.0, 75.0, 150.0), logarithmic=True),
        Parameter("phase_rad", "rad", -TURN, 2.0 * TURN, starts=PHASES, nuisance=True),
        Parameter("breathing_depth", "1", 0.0, 0.9, starts=(0.0,), nuisance=True),
        Parameter("breathing_period_s", "s", 0.5, 500.0, starts=(5.0,), logarithmic=True, nuisance=True),
        Parameter("breathing_phase_rad", "rad", -TURN, 2.0 * TURN, starts=(0.0,), nuisance=True),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="its phase is its own and no reference foretells it; isolate the bench or stop the machine",
    separate_by="a record at rest with the amplifier off: the line stays",
)
