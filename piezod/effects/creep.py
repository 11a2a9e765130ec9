"""After a step the stack continues to move, in proportion to the logarithm of time.

Forward    x + sum_j c_j y_j, tau_j y_j' = x - x(0) - y_j. This is a Kelvin-Voigt chain with 4 elements per decade.
           Driven by the voltage u, it has W (u - u(0)) in place of x - x(0). W is the sum of the weights of the plays.
           Driven by the force, x is the force behind the force law.
Inverse    Subtract the predicted states, then advance them. Exact when the stroke drives the creep (derived here).
Signature  A hold continues in the direction of the last step, straight in log t, in proportion to the step. Loops open
           equally at every frequency, so that plays absorb it. Look-alikes: thermal_drift does not follow steps,
           charge_leakage returns to the start value.
Location   Stack, between the plays and the force law; driven by the force, behind the force law.
Valid      Holds of a decade or more within from_s and to_s; to_s is at least 3 from_s.
           Without holds the plays absorb it.
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers, creep; H. Jung and D. G. Gweon (2000),
           Creep Characteristics of Piezoelectric Actuators, Review of Scientific Instruments 71(4); the weights of the
           end elements: derived here; piezod/effects/README.md, "Creep".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Context, Effect, Location, Past, Values
from piezod.effects.kernels import chain_run, first_order_coefficients, first_order_step
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting

PER_DECADE = 4  # elements per decade of time
NARROWEST = 3.0  # smallest ratio of to_s to from_s
FIRST_EXTRA, LAST_EXTRA = 0.596, 1.260  # added weight of the first and of the last element; see `spectrum`
DECAYS = 3  # columns of an unknown past: 0.01, 0.14 and 2 times the duration
PLAYS, VOLTAGE, FORCE = 0.0, 1.0, 2.0  # values of `driven_by`


def spectrum(from_s: float, to_s: float, slope: float = 0.0, seen_s: float = math.inf) -> tuple[Array, Array]:
    """Chain of elements whose step response rises by 1 per decade of time.

    A flat density between the ends gives too little rise: E1(1) = 0.219 at the first end, Ein(1) = 0.797 at the last.
    The end elements therefore weigh 0.219 / (1 / e) and 0.797 / (1 - 1 / e) more (derived here).

    Parameters
    ----------
    from_s, to_s
        First and last time constant [s], above 0.
    slope
        The weights are proportional to tau^slope [1].
    seen_s
        Duration of the recording in which the creep was found [s]. The slope leaves the weight unchanged in the middle
        of the time span that this recording shows.

    Returns
    -------
    tau_s, weights
        Time constants [s] and weights [1], shape (elements,).
    """
    to_s = max(to_s, NARROWEST * from_s)
    decades = math.log10(to_s / from_s)
    count = max(3, math.ceil(PER_DECADE * decades) + 1)
    tau_s = np.geomspace(from_s, to_s, count)
    weights = np.full(count, math.log(to_s / from_s) / (count - 1))
    weights[0] = 0.5 * weights[0] + FIRST_EXTRA
    weights[-1] = 0.5 * weights[-1] + LAST_EXTRA
    rise = float(weights @ (np.exp(-from_s / tau_s) - np.exp(-to_s / tau_s)))
    middle_s = math.sqrt(from_s * max(min(to_s, seen_s), NARROWEST * from_s))
    return tau_s, weights * decades / rise * (tau_s / middle_s) ** slope


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Stroke with the creep since the first sample, shape (N,) [V].

    `signal` is the stroke [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    seen_s = context.seen_s or context.duration_s
    tau_s, weights = spectrum(values["from_s"], values["to_s"], values.get("slope", 0.0), seen_s)
    driver = signal
    if round(values.get("driven_by", PLAYS)) == VOLTAGE:
        driver = context.stroke_per_V * context.applied_V
    crept = chain_run(driver, tau_s, values["per_decade"] * weights, context.dt_s, context.hold.number)
    out: Array = signal + crept
    return out


def _decays(context: Context, values: Values) -> Array:
    """Decays of the elements that a recording can separate, shape (N, DECAYS) [1].

    They lie between a hundredth of the recording and twice it: faster ones are gone, slower ones a drift of the zero.
    """
    shown_s = np.geomspace(0.01 * context.duration_s, 2.0 * context.duration_s, DECAYS)
    decays: Array = np.exp(-context.time_s[:, None] / np.clip(shown_s, values["from_s"], values["to_s"]))
    return decays


COUNT, VOLTAGE_SHARE, DRIVE_V, START, ELEMENTS = range(5)  # memory; then keep, ramp, weight and state of every element
LONGEST_S = 1e5  # longer time constants are not compensated


def _memory(values: Values, setting: TickSetting) -> Array:
    to_s = min(values["to_s"], LONGEST_S)
    tau_s, weights = spectrum(values["from_s"], to_s, values.get("slope", 0.0), setting.seen_s)
    rows = [first_order_coefficients(element_s, setting.dt_s, setting.hold.number) for element_s in tau_s]
    keep, ramp = np.array(rows).T
    by_voltage = round(values.get("driven_by", PLAYS)) == VOLTAGE
    head = [float(tau_s.size), setting.stroke_per_V if by_voltage else 0.0, 0.0, 0.0]
    return np.concatenate((head, keep, ramp, values["per_decade"] * weights, np.zeros(tau_s.size)))


def _advance(own: Memory, shared: Memory, stroke_V: float) -> float:
    count, before_V = int(own[COUNT]), own[DRIVE_V]
    if own[VOLTAGE_SHARE] > 0.0:
        now_V = own[VOLTAGE_SHARE] * (shared[SHARED.now_V] - shared[SHARED.start_V])
    else:
        now_V = stroke_V - own[START]
    own[DRIVE_V] = now_V
    crept_V = 0.0
    for j in range(ELEMENTS, ELEMENTS + count):
        keep, ramp, weight, state = own[j], own[j + count], own[j + 2 * count], j + 3 * count
        own[state] = first_order_step(own[state], before_V, now_V, keep, ramp)
        crept_V += weight * own[state]
    return stroke_V + crept_V


def _invert(own: Memory, shared: Memory, stroke_V: float) -> float:
    """Output of the plays for a stroke: what creeps by itself, and what creeps with the drive of this tick."""
    count, before_V = int(own[COUNT]), own[DRIVE_V]
    constant_V, share = 0.0, 0.0
    for j in range(ELEMENTS, ELEMENTS + count):
        keep, ramp, weight, state = own[j], own[j + count], own[j + 2 * count], own[j + 3 * count]
        constant_V += weight * first_order_step(state, before_V, 0.0, keep, ramp)
        share += weight * ramp
    if own[VOLTAGE_SHARE] > 0.0:
        shared[SHARED.used_now_V] = 1.0
        now_V = own[VOLTAGE_SHARE] * (shared[SHARED.now_V] - shared[SHARED.start_V])
        return stroke_V - constant_V - share * now_V
    return (stroke_V - constant_V + share * own[START]) / (1.0 + share)


def _settle(own: Memory, _shared: Memory, stroke_V: float) -> float:
    count = int(own[COUNT])
    own[DRIVE_V], own[START] = 0.0, stroke_V
    for j in range(ELEMENTS + 3 * count, ELEMENTS + 4 * count):
        own[j] = 0.0
    return stroke_V


EFFECT = Effect(
    name="creep",
    title="creep of the stack",
    location=Location.STACK,
    form="linear",
    parameters=(
        Parameter("per_decade", "1", 0.0, 0.3, Search((0.01,))),
        Parameter("from_s", "s", 1e-3, 10.0, Search((0.1,), logarithmic=True)),
        Parameter("to_s", "s", 1.0, 1e5, Search((1000.0, 30.0), logarithmic=True)),
        Parameter("slope", "1", -0.15, 0.15, Search((0.0,), nuisance=True)),
        Parameter("driven_by", "1", 0.0, 2.0, Search((0.0,), nuisance=True, choices=(PLAYS, VOLTAGE, FORCE))),
    ),
    forward=forward,
    behind_law=("driven_by", FORCE),
    past=Past(DECAYS, _decays),
    handling="compensated",
    tick=Tick(_memory, _advance, _invert, _settle),
    docstring=__doc__,
    separate_by="a staircase with holds of three decades of time, up and down",
    place=lambda values, record: ("history_s", values["from_s"], record.longest_s),
    flexible=True,
)
