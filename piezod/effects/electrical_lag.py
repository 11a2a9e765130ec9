"""First-order lag of the amplifier's output resistance into the stack's capacitance.

Forward    tau du'/dt = u - u', tau = R C, exact for a voltage that runs straight between samples; C grows with the
           voltage, tau = time constant (1 + swell (u' - 60 V) / 100 V), u' as it stands at the sample's start
Inverse    u = u' + tau du'/dt: reached at the end of the tick (derived here)
Signature  loops widen in proportion to the rate, corners are rounded; nothing is left while the voltage rests;
           look-alikes sensor_filter (shapes the noise too), transport_delay (sharp corners), slew_limit (above a rate)
Seat       amplifier, in front of the hysteresis
Valid      0.1 ms to 0.5 s; below 1.5 samples it cannot be told from a filter or a delay
Source     derived here: R of 10 to 1000 ohm into C of 0.1 to 10 uF; linear growth of C with the voltage chosen here;
           piezod/effects/README.md, "Electrical lag"
"""

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import first_order_run, swelling_run


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Voltage at the stack, shape (N,) [V]."""
    swell = values.get("swell", 0.0)
    if swell == 0.0:
        return first_order_run(signal, values["time_constant_s"], context.dt_s, context.hold.number)
    out: Array = swelling_run(signal, values["time_constant_s"], swell, context.dt_s, context.hold.number)
    return out


EFFECT = Effect(
    name="electrical_lag",
    title="electrical lag of the amplifier",
    seat=Seat.AMPLIFIER,
    form="other",
    parameters=(
        Parameter("time_constant_s", "s", 1e-4, 0.5, starts=(3e-3, 3e-2), logarithmic=True),
        Parameter("swell", "1", -0.2, 1.0, starts=(0.0,), nuisance=True, may_lack=True),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    docstring=__doc__,
    separate_by="the amplifier's monitor output beside the load cell, or triangles at 1 and 10 Hz about two biases",
)
