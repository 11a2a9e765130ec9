"""The charge amplifier of the load cell discharges, so the mean of the signal decays.

Forward    F(0) + x, tau x' + x = tau F'. This is a high-pass, exact for a straight and for a held force.
Inverse    On the reading: F = F_m + (1 / tau) integral of F_m. The mean is not observable.
Signature  Holds decay to the start value; slow loops lean and run clockwise, 12.5 / (f tau) % wide. Look-alikes:
           creep continues in the direction of the step, thermal_drift does not return.
Location   Load cell.
Valid      tau from a few samples to about 100 times the record; a longer one leaves no visible decay.
Source     Kistler Instrumente AG, Basics of Piezoelectric Measuring Technology, "Time constant and drift";
           piezod/effects/README.md, "Charge leakage".
"""

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Past, Values
from piezod.effects.kernels import first_order_coefficients, first_order_run, first_order_step
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting

NO_LONGER = 0.99  # of the range: a leak as slow as the recordings can show is a drift


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal of the charge amplifier, at rest at the first sample, shape (N,) [N].

    `signal` is the signal of the load cell [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    lost = first_order_run(signal, values["time_constant_s"], context.dt_s, context.hold.number)
    out: Array = signal - (lost - signal[0])
    return out


def _decay(context: Context, values: Values) -> Array:
    """Decay of the charge that was there at the first sample, shape (N, 1) [1]."""
    decay: Array = np.exp(-context.time_s[:, None] / values["time_constant_s"])
    return decay


KEEP, RAMP, START_N, INPUT_N, LOST_N = range(5)  # memory: constants; force at the start, input, lost force


def _memory(values: Values, setting: TickSetting) -> Array:
    keep, ramp = first_order_coefficients(values["time_constant_s"], setting.dt_s, setting.hold.number)
    return np.array([keep, ramp, 0.0, 0.0, 0.0])


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    own[LOST_N] = first_order_step(own[LOST_N], own[INPUT_N], force_N, own[KEEP], own[RAMP])
    own[INPUT_N] = force_N
    return force_N - (own[LOST_N] - own[START_N])


def _settle(own: Memory, _shared: Memory, force_N: float) -> float:
    own[START_N] = own[INPUT_N] = own[LOST_N] = force_N
    return force_N


EFFECT = Effect(
    name="charge_leakage",
    title="leakage of the charge amplifier",
    location=Location.LOAD_CELL,
    form="linear",
    parameters=(Parameter("time_constant_s", "s", 0.5, 1e4, Search((10.0, 100.0, 1000.0), logarithmic=True)),),
    forward=forward,
    past=Past(1, _decay),
    handling="corrected in the reading",
    tick=Tick(_memory, _advance, settle=_settle),
    docstring=__doc__,
    why="the true force has not changed: driving against the reading would move the stack by the lost mean",
    separate_by="a dead weight left on the load cell, or triangles of ever lower frequency",
    place=lambda values, record: ("history_s", values["time_constant_s"], record.longest_s),
    plausible=lambda values, record: values["time_constant_s"] <= NO_LONGER * record.highest["time_constant_s"],
    checks=Checks(values={"time_constant_s": 1.0}),
)
