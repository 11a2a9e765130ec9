"""An external machine shakes the bench at its own frequency.

Forward    F + amplitude (1 + depth sin(2 pi t / period + p)) sin(2 pi f t + phase).
Inverse    Refused.
Signature  One line that belongs neither to the drive nor to the mains; its amplitude may vary slowly. Look-alikes:
           mains_hum (50 or 60 Hz and harmonics), resonance (rings after corners only).
Location   Mechanics.
Valid      f from a few periods per record to half the sampling rate. The amplitude varies slower than ten periods of f.
Source     Derived here; piezod/effects/README.md, "Vibration".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values, at_its_frequency
from piezod.effects.parameter import Parameter, Search, below_the_fastest_mode

TURN = 2.0 * math.pi
PHASES = (0.0, 1.57, 3.14, 4.71)


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force with the vibration, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
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
    location=Location.MECHANICS,
    form="additive",
    parameters=(
        Parameter("amplitude_N", "N", 0.0, 1e3, Search((0.3,))),
        Parameter(
            "frequency_Hz",
            "Hz",
            0.1,
            5000.0,
            Search((10.0, 25.0, 75.0, 150.0), logarithmic=True),
            shown_by=below_the_fastest_mode,
        ),
        Parameter("phase_rad", "rad", -TURN, 2.0 * TURN, Search(PHASES, nuisance=True)),
        Parameter("breathing_depth", "1", 0.0, 0.9, Search((0.0,), nuisance=True)),
        Parameter("breathing_period_s", "s", 0.5, 500.0, Search((5.0,), logarithmic=True, nuisance=True)),
        Parameter("breathing_phase_rad", "rad", -TURN, 2.0 * TURN, Search((0.0,), nuisance=True)),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="no reference predicts its phase; isolate the bench or stop the machine",
    separate_by="a record at rest with the amplifier off: the line stays",
    place=at_its_frequency,
    found_by="test",
    repeats=False,
    checks=Checks(values={"breathing_depth": 0.5}, constant="varies"),
)
