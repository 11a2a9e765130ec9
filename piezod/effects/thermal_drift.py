"""The force follows the temperature.

Forward    F + coefficient (T - T(0)); T behind a first-order lag from the sensor to the mount
Inverse    subtract the same from the reference, with the channel or its last value, bounded
Signature  an offset that follows the recorded temperature, whatever is driven; look-alikes creep (starts at a step),
           charge_leakage (goes to zero), gain_drift (scales with the loop)
Seat       mechanics
Valid      records in which the temperature changes; needs the channel temperature_C
Source     derived here: 0.5 to 30 N/K from 5 to 50 N/um, 20 to 40 mm, 5 to 15 ppm/K;
           piezod/effects/README.md, "Thermal drift"
"""

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import first_order_run


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force and what the temperature adds, shape (N,) [N]."""
    temperature = context.temperature_C
    assert temperature is not None  # `needs`
    lag_s = values.get("lag_s", 0.0)
    warmer = temperature - temperature[0]
    felt = first_order_run(warmer, lag_s, context.dt_s) if lag_s > 0.0 else warmer
    out: Array = signal + values["coefficient_N_per_K"] * felt
    return out


EFFECT = Effect(
    name="thermal_drift",
    title="thermal drift",
    seat=Seat.MECHANICS,
    form="additive",
    parameters=(
        Parameter("coefficient_N_per_K", "N/K", -1e3, 1e3, starts=(1.0,)),
        Parameter("lag_s", "s", 0.0, 300.0, starts=(0.0, 30.0), nuisance=True),
    ),
    forward=forward,
    handling="compensated",
    needs="temperature_C",
    docstring=__doc__,
    separate_by="a hold at zero voltage after a reset cycle while the room changes by some kelvin",
)
