"""A charge-type load cell forgets its mean.

Forward    F(0) + x, tau x' + x = tau F': a high-pass of time constant tau, exact for a straight or held force
Inverse    F = F_m + integral of F_m / tau on the reading; the mean cannot be told
Signature  holds decay towards the start, slow loops lean and run clockwise, 12.5 / (f tau) % wide; look-alikes creep
           (goes on in the step's direction), thermal_drift (stays)
Seat       load cell
Valid      tau from a few samples to some hundred times the record; beyond, a drift of nothing
Source     Kistler Instrumente AG, Basics of Piezoelectric Measuring Technology, time constant and drift;
           piezod/effects/README.md, "Charge leakage"
"""

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import first_order_run


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal of the charge amplifier, at rest at the first sample, shape (N,) [N]."""
    forgotten = first_order_run(signal, values["time_constant_s"], context.dt_s, context.hold.number)
    out: Array = signal - (forgotten - signal[0])
    return out


EFFECT = Effect(
    name="charge_leakage",
    title="leakage of the charge amplifier",
    seat=Seat.LOAD_CELL,
    form="linear",
    parameters=(Parameter("time_constant_s", "s", 0.5, 1e4, starts=(10.0, 100.0, 1000.0), logarithmic=True),),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="the true force has not changed: driving against it would push the stack away with the forgotten mean",
    separate_by="a dead weight left on the load cell, or triangles of ever lower frequency",
)
