"""Minor loops differ with bias or with cycle count, which no sum of plays and force law reproduces.

Forward    v = x + share s/2 (P + C - m b).
           P = sum_i sum_jd w_jd h_j(i) [T_d(x_i) - T_d(y)] / n;
           C = sum_d c_d [T_d(y) - T_d(-1)]; x_i = 2 z_i / s - 1, y = 2 u / s - 1.
           b is the state of `bouc_wen` moved by u: a memory that fades.
           s is the identified voltage range, z_i are the states of n plays up to s.
           h_j are hat functions over i, T_d are Chebyshev polynomials.
Inverse    Refused: it is no play operator, and the sum need not be monotone.
Signature  Equal minor loops open differently at different biases; with m they drift from cycle to cycle. Flat in
           frequency, nothing at rest. Look-alikes: output_nonlinearity is equal on both branches, friction slides after
           a small part of the range.
Location   Stack, in front of creep.
Valid      Voltages from 0 to s. Degrees d to 5; w_j1 alone is congruent, and c_d is equal on both branches.
Source     I. D. Mayergoyz (2003), Mathematical Models of Hysteresis and Their Applications, Elsevier, congruency.
           M. Brokate and J. Sprekels (1996), Hysteresis and Phase Transitions, doi:10.1007/978-1-4612-4048-8.
           The expansion: derived here; piezod/effects/README.md, "Noncongruent minor loops".
"""

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.kernels import bouc_wen
from piezod.effects.parameter import Parameter, Search
from piezod.operators.compiled_cache import forget_outdated_steps
from piezod.operators.play import next_state

PLAYS = 24  # n
HATS = 4
DEGREES = 5  # of the polynomials
RIDGE = 0.1  # of a weight: small against the information of a useful recording; without information the weight stays 0
RIDGE_OF_MEMORY = 1e-4  # of the parameters that shape b
SMALLEST_BRANCH = 0.02  # of the driven range: a smaller branch hardly opens a loop
ALIKE = 1.5  # largest ratio of two branches that count as alike
HEIGHTS = 42  # of branches that are compared; each is 10 % above the one before
COLUMNS, ADDED, MEMORY = "minor loops, columns", "minor loops, added", "minor loops, memory"  # names in the cache
TRAVEL = 0.3  # movement in which b rises to 63 % with memory_way = 1, as a part of the voltage range
NAMES = (
    *(f"degree_{d}_{j}" for d in range(1, DEGREES + 1) for j in range(HATS)),
    *(f"curve_{d}" for d in range(2, DEGREES + 1)),
)


@numba.njit(cache=True, nogil=True)
def _polynomials(x: float, out: Array) -> None:
    """Write the Chebyshev polynomials T_1(x) to T_d(x) into `out`, shape (d,), by their recurrence."""
    before, now = 1.0, x
    for d in range(out.size):
        out[d] = now
        before, now = now, 2.0 * x * now - before


@numba.njit(cache=True, nogil=True)
def _columns(u: Array, path: Array, span: float, hats: Array, degrees: int) -> Array:
    """Added term for the value 1 of every weight in `NAMES`, shape (N, NAMES) [V].

    Parameters
    ----------
    u
        Applied voltage, shape (N,) [V].
    path
        Voltages from the de-energised state to the first sample, shape (P,) [V].
    span
        Identified voltage range s [V].
    hats
        h_j(i), shape (PLAYS, HATS) [1].
    degrees
        Largest degree d of the polynomials.
    """
    n, count = hats.shape
    z, out = np.zeros(n), np.empty((u.size, degrees * count + degrees - 1))
    x, before, now = np.empty(n), np.empty(n), np.empty(n)  # x_i, T_{d-1}(x_i) and T_d(x_i) of all plays
    of_voltage, at_zero = np.empty(degrees), np.empty(degrees)
    _polynomials(-1.0, at_zero)
    parts, all_plays = np.ascontiguousarray(hats.T), hats.sum(axis=0)
    first = np.array([np.flatnonzero(one)[0] for one in parts])
    end = np.array([np.flatnonzero(one)[-1] + 1 for one in parts])
    r = span * ((np.arange(n) + 0.5) / n) ** 1.5
    for k in range(path.size):
        for i in range(n):
            z[i] = next_state(z[i], r[i], path[k])
    for k in range(u.size):
        _polynomials((2.0 * u[k] - span) / span, of_voltage)
        for i in range(n):
            z[i] = next_state(z[i], r[i], u[k])
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
            out[k, degrees * count + d - 1] = 0.5 * span * (of_voltage[d] - at_zero[d])
    return out


def _hats() -> Array:
    """Weight of play i in hat j, shape (PLAYS, HATS) [1]."""
    centres = np.linspace(0.0, PLAYS - 1.0, HATS)
    return np.array([np.interp(np.arange(PLAYS), centres, one) for one in np.eye(HATS)]).T.copy()


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Stroke with the noncongruent term, shape (N,) [V].

    `signal` is the stroke [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    weights = np.array([values.get(name, 0.0) for name in NAMES])
    share, span_V = values.get("share", 1.0), context.voltage_span_V
    unit = _unit_columns(context)
    known = context.cache.get(ADDED)
    if known is None or (known[0] != weights).any():
        known = weights, unit @ weights
        context.cache[ADDED] = known
    result: Array = signal + share * known[1]
    memory = values.get("memory", 0.0)
    if memory != 0.0:
        result -= (0.5 * span_V * share * memory) * _memory(context, values)
    return result


def columns(context: Context, values: Values) -> Array:
    """Derivatives of the output by the weights, shape (N, weights) [V].

    Parameters as in `piezod.effects.effect.Columns`.
    """
    unit = _unit_columns(context)
    memory = -0.5 * context.voltage_span_V * _memory(context, values)
    return values.get("share", 1.0) * np.column_stack((unit, memory))


def _unit_columns(context: Context) -> Array:
    """`_columns` for the applied voltage, from the cache where possible. A new voltage clears the cache."""
    known = context.cache.get(COLUMNS)
    if known is None or known[0] is not context.applied_V:
        forget_outdated_steps(_columns.stats.cache_path)
        path = np.array(context.path_V, dtype=np.float64)
        known = context.applied_V, _columns(context.applied_V, path, context.voltage_span_V, _hats(), DEGREES)
        context.cache[COLUMNS] = known
        for name in (ADDED, MEMORY):
            context.cache.pop(name, None)
    return known[1]


def _memory(context: Context, values: Values) -> Array:
    """State b, shape (N,) [1], from the cache where only weights differ from the last call."""
    shape = np.array([values.get(name, 1.0) for name in ("memory_way", "memory_exponent", "memory_closing")])
    known = context.cache.get(MEMORY)
    if known is None or (known[0] != shape).any():
        path = np.array(context.path_V, dtype=np.float64)
        travel_V = TRAVEL * context.voltage_span_V * shape[0]
        known = shape, bouc_wen(path, context.applied_V, travel_V, shape[1], shape[2])
        context.cache[MEMORY] = known
    return known[1]


@numba.njit(cache=True, nogil=True)
def _turns(u: Array, least: float) -> Array:
    """Values at the first sample and at the turns of a signal that are followed by a move of at least `least`."""
    turns, count, extreme, rises = np.empty(u.size + 1), 1, u[0], True
    turns[0] = u[0]
    for value in u:
        if (value >= extreme) == rises:
            extreme = value
        elif abs(value - extreme) >= least:
            turns[count] = extreme
            count, extreme, rises = count + 1, value, not rises
    turns[count] = extreme
    return turns[: count + 1].copy()


def shown_by(command_V: Array) -> bool:
    """Whether a command has alike minor loops at different biases; otherwise nothing tells whether they are congruent.

    Branches are alike if their heights lie within the factor `ALIKE`. Their biases differ by at least half of their
    height.

    `command_V`: commands, shape (N,) [V].
    """
    least_V = SMALLEST_BRANCH * float(np.ptp(command_V))
    turns_V = _turns(command_V, least_V)
    heights_V, biases_V = np.abs(np.diff(turns_V)), 0.5 * (turns_V[1:] + turns_V[:-1])
    for height_V in least_V * np.geomspace(1.0, 1.0 / SMALLEST_BRANCH, HEIGHTS):
        alike_V = biases_V[(heights_V >= height_V) & (heights_V <= ALIKE * height_V)]
        if alike_V.size and np.ptp(alike_V) > 0.5 * height_V:
            return True
    return False


def _shape(name: str, low: float, high: float, start: float) -> Parameter:
    return Parameter(name, "1", low, high, Search((start,), logarithmic=True, nuisance=True, ridge=RIDGE_OF_MEMORY))


EFFECT = Effect(
    name="noncongruent_minor_loops",
    title="minor loops that depend on the bias",
    location=Location.STACK,
    form="additive",
    parameters=(
        Parameter("share", "1", 0.0, 1.0, Search((1.0,), choices=(1.0,))),
        *(Parameter(name, "1", -3.0, 3.0, Search((0.1,), nuisance=True, ridge=RIDGE)) for name in NAMES),
        Parameter("memory", "1", -3.0, 3.0, Search((0.03,), nuisance=True, ridge=RIDGE)),
        _shape("memory_way", 0.4, 10.0, 1.0),
        _shape("memory_exponent", 0.5, 8.0, 1.5),
        _shape("memory_closing", 0.3, 1.0, 0.7),
    ),
    forward=forward,
    weights=(*NAMES, "memory"),
    columns=columns,
    handling="refused",
    docstring=__doc__,
    why="its inverse is no play operator; identify at the biases that the bench uses",
    separate_by="equal minor loops at three biases, each from the same end of the range",
    flexible=True,
    general=True,
    checks=Checks(
        values=dict.fromkeys((name for name in NAMES if not name.startswith(("degree_2", "curve_2"))), 0.0),
        constant="shifted",
    ),
)
