"""The clocks of command and reading run at different rates.

Forward    Reading k is F(t_k (1 + skew / 10^6)), straight between samples; beyond the record it is the last value.
Inverse    Resample the reading on the clock of the command.
Signature  A delay that grows in proportion to time. Look-alike: transport_delay is constant.
Location   Acquisition.
Valid      Crystals: 1 to 100 ppm, RC oscillators: up to 1 %. Skew times duration must be at least one sample.
Source     Derived here; piezod/effects/README.md, "Clock skew".
"""

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import LATE, Checks, Context, Effect, Location, Values, all_the_time
from piezod.effects.parameter import Parameter, Search


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Reading on its own clock, shape (N,) [N].

    `signal` is the reading [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return np.interp(context.time_s * (1.0 + 1e-6 * values["skew_ppm"]), context.time_s, signal)


EFFECT = Effect(
    name="clock_skew",
    title="clocks of different rates",
    location=Location.ACQUISITION,
    form="linear",
    parameters=(Parameter("skew_ppm", "ppm", -2e4, 2e4, Search((-100.0, 100.0, -1000.0, 1000.0), seen_in="clock")),),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="only the time stamps are wrong, not the true force; take them from one clock",
    separate_by="abrupt edges at the beginning and at the end of a long record",
    place=all_the_time,
    plausible=lambda values, record: 1e-6 * abs(values["skew_ppm"]) * record.longest_s >= LATE * record.dt_s,
    checks=Checks(
        values={"skew_ppm": -10_000.0},
        anticipates=lambda values: values["skew_ppm"] > 0.0,  # the clock of the reading runs ahead
    ),
)
