"""A second input that no file records: a neighbouring actuator that changes the transmission of the force.

Its command c(t) steps at random times to random levels. To the force F, it adds

    amount full c(t) tanh(F / (knee full)),

as the current of a magnetorheological damper scales the damper's force. It is in no catalogue.
"""

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.foreign import FOREIGN, Details, Foreign, ForeignContext
from firmware_sim.concealed.plant.linear import first_order, respond

RISE_S = 0.003  # time constant of the neighbour


def _modulated(force_N: Array, amount: float, details: Details, context: ForeignContext) -> Array:
    dwell_s, knee = details["dwell_s"], details["knee"]
    assert isinstance(dwell_s, float)
    assert isinstance(knee, float)
    command = respond(first_order(RISE_S), _steps(context, force_N.size, dwell_s), context.dt_s, held=True)
    result: Array = force_N + amount * context.full_N * command * np.tanh(force_N / (knee * context.full_N))
    return result


def _steps(context: ForeignContext, count: int, dwell_s: float) -> Array:
    """Random levels from 0 to 1, each for a random time of the mean `dwell_s`, shape (count,)."""
    lasts = context.rng.exponential(dwell_s, 8 + round(3.0 * count * context.dt_s / dwell_s)) + 0.1 * dwell_s
    levels = context.rng.uniform(0.0, 1.0, lasts.size + 1)
    result: Array = levels[np.searchsorted(np.cumsum(lasts), np.arange(count) * context.dt_s)]
    return result


def _drawn(rng: np.random.Generator) -> dict[str, object]:
    return {"dwell_s": float(np.exp(rng.uniform(np.log(0.4), np.log(4.0)))), "knee": rng.uniform(0.05, 0.5)}


SECOND_INPUTS = {"modulating_neighbour": Foreign("force", _modulated, 1e-4, 0.6, _drawn)}

OUTSIDE_CATALOGUE = FOREIGN | SECOND_INPUTS
"""Every effect that is in no catalogue."""
