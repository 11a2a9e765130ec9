"""Minor loops that differ with bias: plays whose weight depends on where they stand, as a Preisach plane has it.

Forward    v = x + share s sum_i [a(r_i) (x_i^2 - y^2) / 2 + b(r_i) (x_i^3 - y^3) / 3] / n, with x_i = 2 z_i / s - 1 and
           y = 2 u / s - 1
Inverse    solved sample by sample as that of the plays is, while the sum stays monotone
Signature  equal minor loops open differently at different biases; flat in frequency, nothing at rest; look-alike
           output_nonlinearity (the same on both branches)
Seat       hysteresis
Valid      any Preisach operator is a sum of functions of play states (Krejci 1996); here of degree 3
Source     THEORY 3 R; s is the identified voltage range, z_i the states of n plays up to it, a and b hats over r
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

PLAYS = 24
HATS = 4


@numba.njit(cache=True, nogil=True)
def _columns(u: Array, path: Array, span: float, hats: Array) -> Array:
    """What the plays of every hat add, by the square and by the cube of their places, shape (2 HATS, N) [V]."""
    n, count = hats.shape
    z, out = np.zeros(n), np.zeros((2 * count, u.size))
    r = span * ((np.arange(n) + 0.5) / n) ** 1.5
    for k in range(path.size):
        for i in range(n):
            z[i] = max(path[k] - r[i], min(path[k] + r[i], z[i]))
    for k in range(u.size):
        y = (2.0 * u[k] - span) / span
        for i in range(n):
            z[i] = max(u[k] - r[i], min(u[k] + r[i], z[i]))
            x = (2.0 * z[i] - span) / span
            square, cube = span / n * (x * x - y * y) / 2.0, span / n * (x * x * x - y * y * y) / 3.0
            for j in range(count):
                if hats[i, j] > 0.0:
                    out[j, k] += hats[i, j] * square
                    out[count + j, k] += hats[i, j] * cube
    return out


def _hats() -> Array:
    """Weight of play i in hat j, shape (PLAYS, HATS)."""
    places = np.linspace(0.0, PLAYS - 1.0, HATS)
    return np.array([np.interp(np.arange(PLAYS), places, one) for one in np.eye(HATS)]).T.copy()


def forward(signal: Array, context: Context, values: Values) -> Array:
    """What the plays give with those whose weight depends on the bias, shape (N,) [V]."""
    known = context.memo.get("noncongruent_minor_loops")
    if known is None or known[0] is not context.applied_V:
        path = np.array(context.path_V, dtype=np.float64)
        known = context.applied_V, _columns(context.applied_V, path, context.voltage_span_V, _hats())
        context.memo["noncongruent_minor_loops"] = known
    weights = np.array([values.get(f"{name}_{k}", 0.0) for name in ("square", "cube") for k in range(HATS)])
    result: Array = signal + (values.get("share", 1.0) * weights) @ known[1]
    return result


EFFECT = Effect(
    name="noncongruent_minor_loops",
    title="minor loops that depend on the bias",
    seat=Seat.STACK,
    form="additive",
    parameters=(
        Parameter("share", "1", 0.0, 1.0, starts=(1.0,), choices=(1.0,)),
        *(
            Parameter(f"{name}_{k}", "1", -3.0, 3.0, starts=(0.1,), nuisance=True)
            for name in ("square", "cube")
            for k in range(HATS)
        ),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why="its inverse is not a play operator; a model identified on the biases that are driven comes closest",
    separate_by="equal minor loops at three biases, each from the same end of the range",
)
