"""The reading freezes for a while.

Forward    F, but F(from_s) from from_s until to_s
Inverse    the stretch is left out
Signature  not one digit changes while the model moves; look-alikes load_step (moves on after its edge),
           quantisation (plateaus everywhere)
Seat       acquisition
Valid      stretches of three samples and more, in which something else than a hold was driven
Source     derived here, from what a device does that answers with its last value
"""

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

LATEST_s = 1e7


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Reading with the frozen stretch, shape (N,) [N]."""
    from_s, to_s = values["from_s"], values["to_s"]
    first, end = np.searchsorted(context.time_s, (from_s, to_s))
    out = signal.copy()
    out[first:end] = np.interp(from_s, context.time_s, signal)
    return out


EFFECT = Effect(
    name="sensor_dropout",
    title="frozen reading",
    seat=Seat.ACQUISITION,
    form="other",
    parameters=(
        Parameter("from_s", "s", 0.0, LATEST_s, starts=(1.0,), place=True),
        Parameter("to_s", "s", 0.0, LATEST_s, starts=(1.5,), place=True),
    ),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="nothing was read there, so the stretch counts neither in a fit nor in a score",
    separate_by="the device's own sample counter recorded beside the reading",
)
