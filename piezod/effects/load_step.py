"""The load or the mount changes at an instant, and may change back.

Forward    F + step from on_s until off_s. Each edge is a straight ramp of rise_s, of one sample at least.
Inverse    Refused.
Signature  One or two abrupt edges that the command does not explain. Look-alikes: thermal_drift has no edge,
           sensor_dropout does not move.
Location   Mechanics.
Valid      Edges inside the record. An off_s beyond its end is a load that stays.
Source     Derived here; the ramp: chosen here; piezod/effects/README.md, "Load step".
"""

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search

NEVER_s = 1e7  # instant beyond every record: the load stays


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force with the step of the load, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    rise = max(values.get("rise_s", 0.0), context.dt_s)  # a shorter edge would have no derivative by its instant
    on = values["on_s"]
    off = max(values["off_s"], on)
    share = np.clip((context.time_s - on) / rise, 0.0, 1.0) - np.clip((context.time_s - off) / rise, 0.0, 1.0)
    out: Array = signal + values["step_N"] * share
    return out


EFFECT = Effect(
    name="load_step",
    title="step of the load",
    location=Location.MECHANICS,
    form="additive",
    parameters=(
        Parameter("step_N", "N", -1e4, 1e4, Search((2.0,))),
        Parameter("on_s", "s", 0.0, NEVER_s, Search((1.0,)), instant=True),
        Parameter("off_s", "s", 0.0, NEVER_s, Search((NEVER_s,)), instant=True),
        Parameter("rise_s", "s", 0.0, 1.0, Search((0.002,), nuisance=True)),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="no reference predicts its instant; find the cause; if the load stays, identify again",
    separate_by="the same record once more: the edge does not return at the same instant",
    place=lambda values, record: (
        "time_s",
        record.start_s + values["on_s"],
        min(record.start_s + values["off_s"], record.end_s),
    ),
    found_by="test",
    repeats=False,
    checks=Checks(values={"on_s": 0.512, "off_s": 1.024, "rise_s": 0.128}, constant="varies"),
)
