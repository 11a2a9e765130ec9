"""Stack and load form a lightly damped mode of second order.

Forward    y'' + 2 zeta w y' + w^2 y = w^2 F, w = 2 pi f. Exact for a straight and for a held force.
Inverse    F = y + 2 zeta / w y' + y'' / w^2, with two samples of preview, for smooth references.
Signature  Ringing at f after corners, a peak of the gain at f, and far below f an error in proportion to the
           acceleration. Look-alikes: vibration rings without corners, sensor_filter and electrical_lag do not ring.
Location   Mechanics.
Valid      2 to 5000 Hz and below half the sampling rate; zeta 0.001 to 1.
Source     H. J. M. T. S. Adriaens, W. L. de Koning and R. Banning (2000), Modeling Piezoelectric Actuators, IEEE/ASME
           Transactions on Mechatronics 5(4); piezod/effects/README.md, "Resonance".
"""

from piezod.effects.effect import Array, Checks, Context, Effect, Location, Parameter, Search, Values, at_its_frequency
from piezod.effects.kernels import second_order

RINGS = 0.6  # damping ratio beyond which nothing is seen to ring: it is a lag


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force behind the mode, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return second_order(signal, values["frequency_Hz"], values["damping_ratio"], context.dt_s, context.hold.number)


EFFECT = Effect(
    name="resonance",
    title="resonance of the mechanics",
    location=Location.MECHANICS,
    form="linear",
    parameters=(
        Parameter("frequency_Hz", "Hz", 2.0, 5000.0, Search((20.0, 50.0, 120.0, 300.0), logarithmic=True)),
        Parameter("damping_ratio", "1", 1e-3, 1.0, Search((0.03, 0.3), logarithmic=True)),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    docstring=__doc__,
    separate_by="steps or triangles with abrupt corners, sampled at ten times the mode's frequency",
    place=at_its_frequency,
    plausible=lambda values, _record: values["damping_ratio"] <= RINGS,
    checks=Checks(values={"frequency_Hz": 8.0, "damping_ratio": 0.1}),
)
