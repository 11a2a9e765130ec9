"""Hysteresis as a Preisach plane, evaluated through its Everett function and a stack of reversal extrema.

The plane is populated by relays that switch up at a and down at b <= a. The Everett function E(x, y) is the weight of
the relays with x <= b and a <= y: what the output changes by between two reversals at x and y. With the remembered
reversals x_1, x_2, ... the output is that of the last reversal plus or minus E between it and the present input, and an
input that passes an older reversal wipes out the pair in between (Mayergoyz, Mathematical Models of Hysteresis, 1991).

Two closed-form densities are added, both smooth:
- of the width w = a - b alone, `g(w) = 1 / (1 + (w/s)^2)`, so that equal minor loops are congruent at every bias:
  E(x, y) = s d atan(d/s) - s^2/2 ln(1 + (d/s)^2), d = y - x (twice integrated, derived here);
- of the place, `p(a) p(b)` with `p(x) = 1 / (1 + (x/q)^2)`: E = (P(y) - P(x))^2 / 2 with P(x) = q atan(x/q). It makes
  loops near zero bias wider than loops far from it.

The stack starts demagnetised (relays with a + b > 0 down): the virgin curve is half of E(-u, u).
"""

import math

from numba import njit

from firmware_sim.physics.layout import REVERSALS, Record


@njit(cache=True)
def everett(parameters: Record, low_V: float, high_V: float) -> float:
    """Return what the output changes by when the input runs from a reversal at `low_V` to `high_V` or back."""
    ratio = (high_V - low_V) / parameters.width_scale_V
    by_width = ratio * math.atan(ratio) - 0.5 * math.log1p(ratio * ratio)
    total: float = parameters.width_weight * parameters.width_scale_V**2 * by_width
    if parameters.bias_weight > 0.0:
        place = parameters.bias_scale_V
        by_place = place * (math.atan(high_V / place) - math.atan(low_V / place))
        total += parameters.bias_weight * 0.5 * by_place * by_place
    return total


@njit(cache=True)
def virgin(parameters: Record, field_V: float) -> float:
    """Return the output on the first rise (or fall) out of the demagnetised state."""
    size_V = abs(field_V)
    half = 0.5 * everett(parameters, -size_V, size_V)
    return math.copysign(half, field_V)


@njit(cache=True)
def move_field(state: Record, parameters: Record, field_V: float) -> None:
    """Move the plane's input to `field_V`; leaves the output in `state.irreversible`."""
    if field_V == state.field_V:
        return
    direction = 1.0 if field_V > state.field_V else -1.0
    if direction * state.direction < 0.0:
        _remember(state)
    state.direction = direction
    _wipe_out(state, direction, field_V)
    state.field_V = field_V
    if state.reversals == 0:
        state.irreversible = virgin(parameters, field_V)
        return
    last_V = state.reversal_V[state.reversals - 1]
    weight = everett(parameters, min(last_V, field_V), max(last_V, field_V))
    state.irreversible = state.reversal_output[state.reversals - 1] + (weight if field_V > last_V else -weight)


@njit(cache=True)
def _remember(state: Record) -> None:
    """Push the present point as a reversal; when the memory is full, its smallest loop is forgotten."""
    if state.reversals == REVERSALS:
        state.reversals -= 2
    state.reversal_V[state.reversals] = state.field_V
    state.reversal_output[state.reversals] = state.irreversible
    state.reversals += 1


@njit(cache=True)
def _wipe_out(state: Record, direction: float, field_V: float) -> None:
    """Forget the reversals that the input passes."""
    while state.reversals >= 2 and direction * (field_V - state.reversal_V[state.reversals - 2]) >= 0.0:
        state.reversals -= 2
    if state.reversals == 1 and direction * field_V >= abs(state.reversal_V[0]):
        state.reversals = 0
