"""Minor loops that differ with bias: plays whose weight depends on where they stand, as a Preisach plane has it.

Forward    v = x + share s/2 {sum_i sum_jd w_jd h_j(i) [T_d(x_i) - T_d(y)] / n + sum_d c_d (T_d(y) - T_d(-1)) - m b},
           x_i = 2 z_i / s - 1, y = 2 u / s - 1, b the state of `bouc_wen` moved by u
Inverse    solved sample by sample as that of the plays is, while the sum stays monotone
Signature  equal minor loops open differently at different biases, and drift from cycle to cycle where the memory fades
           (m); flat in frequency, nothing at rest; look-alikes output_nonlinearity (the same on both branches), and
           friction, which slides after a small part of the range
Seat       hysteresis
Valid      any Preisach operator is a sum of functions of play states (Krejci 1996); here up to degree 5
Source     I. D. Mayergoyz (2003), Mathematical Models of Hysteresis and Their Applications, congruency;
           piezod/effects/README.md, "Noncongruent minor loops".
           s is the identified voltage range, z_i the states of n plays up to it, h_j hats over their
           thresholds, T_d Chebyshev's polynomials. w_j1 alone is congruent, and c_d the same on both branches: a
           share of another hysteresis changes both as well. Memory that fades (accommodation): Bouc and Wen
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import bouc_wen

PLAYS = 24
HATS = 4
DEGREES = 5
STIFF = 0.1  # curvature a sample; what the data tell well is far stiffer, and what they do not stays 0
OF_MEMORY = 1e-4  # the same for what shapes the memory that fades
OF_ONE, ADDED, OF_THE_MEMORY = "minor loops, columns", "minor loops, added", "minor loops, memory"  # memos
TRAVEL = 0.3  # of the voltage range: what the memory's way is counted in
NAMES = (
    *(f"degree_{d}_{j}" for d in range(1, DEGREES + 1) for j in range(HATS)),
    *(f"curve_{d}" for d in range(2, DEGREES + 1)),
)


@numba.njit(cache=True, nogil=True)
def _polynomials(x: float, out: Array) -> None:
    """T_1(x) to T_d(x) by their recurrence."""
    before, now = 1.0, x
    for d in range(out.size):
        out[d] = now
        before, now = now, 2.0 * x * now - before


@numba.njit(cache=True, nogil=True)
def _columns(u: Array, path: Array, span: float, hats: Array, degrees: int) -> Array:
    """What every polynomial of the plays' places adds, hat by hat, and of the voltage's, shape (N, NAMES) [V]."""
    n, count = hats.shape
    z, out = np.zeros(n), np.empty((u.size, degrees * count + degrees - 1))
    x, before, now = np.empty(n), np.empty(n), np.empty(n)  # a polynomial of every play at once
    of_voltage, at_rest = np.empty(degrees), np.empty(degrees)
    _polynomials(-1.0, at_rest)
    parts, all_plays = np.ascontiguousarray(hats.T), hats.sum(axis=0)
    first = np.array([np.flatnonzero(one)[0] for one in parts])
    end = np.array([np.flatnonzero(one)[-1] + 1 for one in parts])
    r = span * ((np.arange(n) + 0.5) / n) ** 1.5
    for k in range(path.size):
        for i in range(n):
            z[i] = max(path[k] - r[i], min(path[k] + r[i], z[i]))
    for k in range(u.size):
        _polynomials((2.0 * u[k] - span) / span, of_voltage)
        for i in range(n):
            z[i] = max(u[k] - r[i], min(u[k] + r[i], z[i]))
            x[i] = (2.0 * z[i] - span) / span
            before[i], now[i] = 1.0, x[i]
        for d in range(degrees):
            for j in range(count):
                of_plays = 0.0
                for i in range(first[j], end[j]):
                    of_plays += parts[j, i] * now[i]
                out[k, d * count + j] = 0.5 * span / n * (of_plays - all_plays[j] * of_voltage[d])
            for i in range(n):
                before[i], now[i] = now[i], 2.0 * x[i] * now[i] - before[i]
        for d in range(1, degrees):
            out[k, degrees * count + d - 1] = 0.5 * span * (of_voltage[d] - at_rest[d])
    return out


def _hats() -> Array:
    """Weight of play i in hat j, shape (PLAYS, HATS)."""
    places = np.linspace(0.0, PLAYS - 1.0, HATS)
    return np.array([np.interp(np.arange(PLAYS), places, one) for one in np.eye(HATS)]).T.copy()


def forward(signal: Array, context: Context, values: Values) -> Array:
    """What the plays give with those whose weight depends on the bias, shape (N,) [V]."""
    weights = np.array([values.get(name, 0.0) for name in NAMES])
    share, span_V = values.get("share", 1.0), context.voltage_span_V
    of_one = _of_one(context)
    known = context.memo.get(ADDED)
    if known is None or (known[0] != weights).any():
        known = weights, of_one @ weights
        context.memo[ADDED] = known
    result: Array = signal + share * known[1]
    memory = values.get("memory", 0.0)
    if memory != 0.0:
        result -= (0.5 * span_V * share * memory) * _remembered(context, values)
    return result


def columns(context: Context, values: Values) -> Array:
    """What one of every weight adds, shape (N, weights) [V]."""
    memory = -0.5 * context.voltage_span_V * _remembered(context, values)
    return values.get("share", 1.0) * np.column_stack((_of_one(context), memory))


def _of_one(context: Context) -> Array:
    """What `_columns` gives for the voltage at hand; it is kept, and what was kept of another voltage is not."""
    known = context.memo.get(OF_ONE)
    if known is None or known[0] is not context.applied_V:
        path = np.array(context.path_V, dtype=np.float64)
        known = context.applied_V, _columns(context.applied_V, path, context.voltage_span_V, _hats(), DEGREES)
        context.memo[OF_ONE] = known
        for name in (ADDED, OF_THE_MEMORY):
            context.memo.pop(name, None)
    return known[1]


def _remembered(context: Context, values: Values) -> Array:
    """State of the memory that fades, shape (N,) [1]; the last one is kept for what differs in the weights alone."""
    shape = np.array([values.get(name, 1.0) for name in ("memory_way", "memory_exponent", "memory_closing")])
    known = context.memo.get(OF_THE_MEMORY)
    if known is None or (known[0] != shape).any():
        path = np.array(context.path_V, dtype=np.float64)
        way_V = TRAVEL * context.voltage_span_V * shape[0]
        known = shape, bouc_wen(path, context.applied_V, way_V, shape[1], shape[2])
        context.memo[OF_THE_MEMORY] = known
    return known[1]


def _shape(name: str, low: float, high: float, start: float) -> Parameter:
    return Parameter(name, "1", low, high, starts=(start,), logarithmic=True, nuisance=True, stiffness=OF_MEMORY)


EFFECT = Effect(
    name="noncongruent_minor_loops",
    title="minor loops that depend on the bias",
    seat=Seat.STACK,
    form="additive",
    parameters=(
        Parameter("share", "1", 0.0, 1.0, starts=(1.0,), choices=(1.0,)),
        *(Parameter(name, "1", -3.0, 3.0, starts=(0.1,), nuisance=True, stiffness=STIFF) for name in NAMES),
        Parameter("memory", "1", -3.0, 3.0, starts=(0.03,), nuisance=True, stiffness=STIFF),
        _shape("memory_way", 0.4, 10.0, 1.0),
        _shape("memory_exponent", 0.5, 8.0, 1.5),
        _shape("memory_closing", 0.3, 1.0, 0.7),
    ),
    forward=forward,
    weights=(*NAMES, "memory"),
    columns=columns,
    handling="refused",
    docstring=__doc__,
    why="its inverse is not a play operator; a model identified on the biases that are driven comes closest",
    separate_by="equal minor loops at three biases, each from the same end of the range",
)
