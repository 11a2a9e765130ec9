"""The clocks of command and reading run at different rates.

Forward    reading k shows F(t_k (1 + skew / 10^6)), straight between samples; the last value beyond the record
Inverse    resample the reading on the command's clock
Signature  a delay that grows in proportion to time; look-alike transport_delay is the same from the start on
Seat       acquisition
Valid      crystals 1 to 100 ppm, RC oscillators up to 1 %; skew times duration of a sample and more
Source     derived here; piezod/effects/README.md, "Clock skew"
"""

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Reading by its own clock, shape (N,) [N]."""
    return np.interp(context.time_s * (1.0 + 1e-6 * values["skew_ppm"]), context.time_s, signal)


EFFECT = Effect(
    name="clock_skew",
    title="clocks of different rates",
    seat=Seat.ACQUISITION,
    form="linear",
    parameters=(Parameter("skew_ppm", "ppm", -2e4, 2e4, starts=(-100.0, 100.0, -1000.0, 1000.0)),),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="the true force is not late, its time stamps are: take them from one clock",
    separate_by="sharp edges at the beginning and at the end of a long record",
)
