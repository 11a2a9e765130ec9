"""A mode of stack and load: second order, hardly damped.

Forward    y'' + 2 zeta w y' + w^2 y = w^2 F, w = 2 pi f, exact for a force that runs straight between samples
Inverse    F = y + 2 zeta / w y' + y'' / w^2: two samples of preview, on smooth references
Signature  ringing at f after corners, a peak of the gain at f, far below it an error in proportion to the acceleration;
           look-alikes vibration (rings without corners), sensor_filter (hardly overshoots), electrical_lag
Seat       mechanics
Valid      f from a few 1/T to near half the sampling rate; zeta 0.001 to 1
Source     Adriaens, de Koning and Banning (2000), Modeling Piezoelectric Actuators, IEEE/ASME Trans. Mechatronics 5(4);
           piezod/effects/README.md, "Resonance"
"""

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import second_order


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force behind the mode, shape (N,) [N]."""
    return second_order(signal, values["frequency_Hz"], values["damping_ratio"], context.dt_s, context.hold.number)


EFFECT = Effect(
    name="resonance",
    title="resonance of the mechanics",
    seat=Seat.MECHANICS,
    form="linear",
    parameters=(
        Parameter("frequency_Hz", "Hz", 2.0, 5000.0, starts=(20.0, 50.0, 120.0, 300.0), logarithmic=True),
        Parameter("damping_ratio", "1", 1e-3, 1.0, starts=(0.03, 0.3), logarithmic=True),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    docstring=__doc__,
    separate_by="steps or triangles with sharp corners, sampled at ten times the mode's frequency",
)
