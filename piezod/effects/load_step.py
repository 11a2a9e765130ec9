"""The load or the mount steps at an instant, and may step back.

Forward    F + step from on_s, until off_s; each edge a straight ramp of rise_s
Inverse    refused
Signature  one sharp edge, or two, at an instant of which the command knows nothing; look-alike thermal_drift has no
           edge, sensor_dropout does not move at all
Seat       mechanics
Valid      edges inside the record; an off_s beyond its end stands for a load that stays
Source     derived here; the ramp chosen here; piezod/effects/README.md, "Load step"
"""

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

NEVER_s = 1e7


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force with the load's, shape (N,) [N]."""
    rise = max(values.get("rise_s", 0.0), context.dt_s)  # an edge between two samples still has a slope to search along
    on = values["on_s"]
    off = max(values["off_s"], on)
    there = np.clip((context.time_s - on) / rise, 0.0, 1.0) - np.clip((context.time_s - off) / rise, 0.0, 1.0)
    out: Array = signal + values["step_N"] * there
    return out


EFFECT = Effect(
    name="load_step",
    title="step of the load",
    seat=Seat.MECHANICS,
    form="additive",
    parameters=(
        Parameter("step_N", "N", -1e4, 1e4, starts=(2.0,)),
        Parameter("on_s", "s", 0.0, NEVER_s, starts=(1.0,), place=True),
        Parameter("off_s", "s", 0.0, NEVER_s, starts=(NEVER_s,), place=True),
        Parameter("rise_s", "s", 0.0, 1.0, starts=(0.002,), nuisance=True),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="it comes from outside at an instant that no reference foretells; find the cause; if it stays, identify again",
    separate_by="the same record once more: a load does not step at the same instant again",
)
