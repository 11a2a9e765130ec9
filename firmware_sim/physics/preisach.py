"""Hysteresis as a Preisach plane, evaluated by its Everett function and a memory of reversals.

The plane consists of relays that switch up at a and down at b <= a. The Everett function E(x, y) is the weight of the
relays with x <= b and a <= y. It equals the change of the output between two reversals at x and y. The output is that
of the last reversal plus or minus E between this reversal and the present input. An input that passes an older reversal
erases the pair of reversals in between. Source: Mayergoyz (1991), Mathematical Models of Hysteresis, chapter 1.

The density is the sum of two smooth closed forms (derived here):

- of the width w = a - b alone, `g(w) = 1 / (1 + (w/s)^2)`. Equal minor loops are congruent at every bias.
  E(x, y) = s d atan(d/s) - s^2/2 ln(1 + (d/s)^2) with d = y - x.
- of the bias too, `p(a) p(b)` with `p(x) = 1 / (1 + (x/q)^2)`. Loops near zero bias are wider than loops far from it.
  E = (P(y) - P(x))^2 / 2 with P(x) = q atan(x/q).

The stack starts demagnetised: relays with a + b > 0 are down. The virgin curve is half of E(-u, u).
"""

import math

from numba import njit

from firmware_sim.physics.layout import REVERSALS, Record


@njit(cache=True)
def everett(parameters: Record, low_V: float, high_V: float) -> float:
    """Return E(low, high) [V]: the change of the output when the input runs between two reversals.

    Parameters
    ----------
    low_V, high_V
        Reversals of the input [V], low at most high.
    """
    ratio = (high_V - low_V) / parameters.width_scale_V
    by_width = ratio * math.atan(ratio) - 0.5 * math.log1p(ratio * ratio)
    total: float = parameters.width_weight * parameters.width_scale_V**2 * by_width
    if parameters.bias_weight > 0.0:
        scale_V = parameters.bias_scale_V
        by_bias = scale_V * (math.atan(high_V / scale_V) - math.atan(low_V / scale_V))
        total += parameters.bias_weight * 0.5 * by_bias * by_bias
    return total


@njit(cache=True)
def virgin(parameters: Record, field_V: float) -> float:
    """Return the output [V] on the first rise or fall from the demagnetised state.

    Parameters
    ----------
    field_V
        Input of the plane [V].
    """
    size_V = abs(field_V)
    half = 0.5 * everett(parameters, -size_V, size_V)
    return math.copysign(half, field_V)


@njit(cache=True)
def move_field(state: Record, parameters: Record, field_V: float) -> None:
    """Move the input of the plane to `field_V`; the output goes to `state.irreversible`.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    field_V
        New input of the plane [V].
    """
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
    """Store the present point as a reversal; a full memory drops its smallest loop first."""
    if state.reversals == REVERSALS:
        state.reversals -= 2
    state.reversal_V[state.reversals] = state.field_V
    state.reversal_output[state.reversals] = state.irreversible
    state.reversals += 1


@njit(cache=True)
def _wipe_out(state: Record, direction: float, field_V: float) -> None:
    """Erase the reversals that the input passes."""
    while state.reversals >= 2 and direction * (field_V - state.reversal_V[state.reversals - 2]) >= 0.0:
        state.reversals -= 2
    if state.reversals == 1 and direction * field_V >= abs(state.reversal_V[0]):
        state.reversals = 0
