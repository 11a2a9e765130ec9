"""The device answers with its last reading for a while.

Forward    F, but F(from_s) from from_s until to_s.
Inverse    None. The stretch counts neither in a fit nor in a score.
Signature  Equal readings while the model moves. Look-alikes: load_step moves after its edge, quantisation has plateaus
           everywhere.
Location   Acquisition.
Valid      Stretches of at least three samples, outside of a hold.
Source     Derived here for a device that repeats its last value; piezod/effects/README.md, "Sensor dropout".
"""

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search

LATEST_s = 1e7  # later than every record


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Reading with the frozen stretch, shape (N,) [N].

    `signal` is the reading [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    from_s, to_s = values["from_s"], values["to_s"]
    first, end = np.searchsorted(context.time_s, (from_s, to_s))
    out = signal.copy()
    out[first:end] = np.interp(from_s, context.time_s, signal)
    return out


EFFECT = Effect(
    name="sensor_dropout",
    title="frozen reading",
    location=Location.ACQUISITION,
    form="other",
    parameters=(
        Parameter("from_s", "s", 0.0, LATEST_s, Search((1.0,)), instant=True),
        Parameter("to_s", "s", 0.0, LATEST_s, Search((1.5,)), instant=True),
    ),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="the device measured nothing there; the stretch counts neither in a fit nor in a score",
    separate_by="the device's own sample counter recorded beside the reading",
    found_by="test",
    repeats=False,
    checks=Checks(values={"from_s": 0.512, "to_s": 0.768}),
)
