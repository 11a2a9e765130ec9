"""The inverse of a model with effects: what of them is driven against, what is refused, what shapes the reference."""

import math
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod import effects
from piezod.effects import EFFECTS
from piezod.effects.creep import PLAYS, spectrum
from piezod.effects.kernels import first_order_coefficients, second_order_matrices
from piezod.effects.output_nonlinearity import rising
from piezod.effects.rate_dependent_hysteresis import OFFSET_SHARE, USUAL_DISTANCE_V
from piezod.errors import ModelError
from piezod.model import inverse_chain as at
from piezod.model.inverse_chain import commit_chain_step, plan_chain_step, start_chain
from piezod.model.parameters import Model
from piezod.operators import ImplicitInverse
from piezod.operators.compiled_cache import OPERATORS, forget_outdated_steps
from piezod.recording.hold import HELD_ONE_SAMPLE, STRAIGHT

Array = NDArray[np.float64]
Found = Mapping[str, Mapping[str, float]]

MOST_WARMER_K = 50.0  # beyond it a temperature is a fault of its sensor, not the weather
AHEAD_OF_MODE = np.array([-0.125, 0.625, 0.625, -0.125])  # half a sample ahead, flat to second order: derived here
CALLED = (OPERATORS, Path(effects.__file__).parent)  # whose steps the chain's call
MEMORY_S = 1e5  # of the slowest creep that is driven against


class ExtendedCompensator:
    """The whole chain's inverse, tick by tick.

    Parameters
    ----------
    model
        With its effects; those that belong to one recording do not act.
    dt_s
        Tick period [s].
    without
        Effects that are knowingly not driven against.

    Raises
    ------
    ModelError
        The model has no inverse, or an effect that has none: its name, the reason and what to do are said.
    """

    def __init__(self, model: Model, dt_s: float, without: Collection[str] = ()) -> None:
        self._model = model
        found = acting_effects(model, without)
        refuse(found)
        forget_outdated_steps(plan_chain_step.stats.cache_path, CALLED)
        self._chain = chain_constants(model, found, dt_s)
        self._packed = ImplicitInverse(model.operator()).packed
        self.delay_s = _delay_s(model, found, without)
        self._lag_s = found.get("electrical_lag", {}).get("time_constant_s", 0.0)
        self._mode = found.get("resonance")
        thermal = found.get("thermal_drift", {})
        self._per_K = thermal.get("coefficient_N_per_K", 0.0)
        lag_s = thermal.get("lag_s", 0.0)
        self._takes_up = -math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0
        self._first_C = self._felt_C = math.nan
        self.dt_s = dt_s
        start_chain(self._packed, self._chain)

    def reset(self) -> None:
        """Back to the model's start state, at rest; the temperature that is felt next counts as the start's."""
        self._packed[:] = ImplicitInverse(self._model.operator()).packed
        start_chain(self._packed, self._chain)
        self._first_C = self._felt_C = math.nan

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N] that the next reading is to show; moves no state."""
        return plan_chain_step(self._packed, self._chain, reference)

    def commit(self, voltage_V: float) -> None:
        """Move every state with the voltage that was really written."""
        commit_chain_step(self._packed, self._chain, voltage_V)

    def feel(self, temperature_C: float) -> None:
        """Take a temperature [degC]; one that is not there, or cannot be, leaves what was felt last."""
        if math.isnan(self._first_C) and math.isfinite(temperature_C):
            self._first_C = self._felt_C = temperature_C
        if not abs(temperature_C - self._first_C) <= MOST_WARMER_K:
            return
        self._felt_C += self._takes_up * (temperature_C - self._felt_C)
        self._chain[at.THERMAL_N] = self._per_K * (self._felt_C - self._first_C)

    @property
    def arrays(self) -> tuple[Array, Array]:
        """The operator's packed array and the chain's constants and states: what the steps of `inverse_chain` move."""
        return self._packed, self._chain

    @property
    def elements(self) -> int:
        """Of the creep."""
        return (self._chain.size - at.FIRST) // 4

    @property
    def preview_s(self) -> float:
        """How far ahead a reference must be known for all of it [s]."""
        return self.delay_s + (2.0 * self.dt_s if self._mode else 0.0)

    @property
    def late_s(self) -> float:
        """By how much readings follow a reference that is not known ahead: the delay, and the slope of the mode [s]."""
        late_s = ticks_late(self.delay_s, self._lag_s, self.dt_s) * self.dt_s
        if self._mode is not None:
            late_s += self._mode["damping_ratio"] / (math.pi * self._mode["frequency_Hz"])
        return late_s

    @property
    def preview_ticks(self) -> int:
        """The same in whole ticks."""
        return math.ceil(self.preview_s / self.dt_s)

    def ahead(self, values: Array, *, loop: bool) -> Array:
        """What to plan for, so that readings follow `values`: earlier by the delay, the inverse of the mode.

        Parameters
        ----------
        values
            Of a reference known ahead, one a tick, shape (N,) [N].
        loop
            Whether they begin again at the end; else they rest there.
        """
        if self.preview_s == 0.0:
            return values
        margin = self.preview_ticks + 3
        wide = np.pad(values, margin, mode="wrap" if loop else "edge")
        ticks = np.arange(wide.size, dtype=np.float64)
        if self.delay_s > 0.0:
            wide = np.interp(ticks + ticks_late(self.delay_s, self._lag_s, self.dt_s), ticks, wide)
        if self._mode is not None:
            wide = before_mode(wide, self._mode["frequency_Hz"], self._mode["damping_ratio"], self.dt_s)
        return wide[margin:-margin]


def _delay_s(model: Model, found: Found, without: Collection[str]) -> float:
    """From the end of a tick, until which its voltage is held, to the reading that shows it [s].

    Where the recording was read some time after each command, a part of the delay is in how it was sampled. A command
    that was held and is taken for straight arrives half a sample early in the fit.
    """
    if "transport_delay" in without:
        return 0.0
    return found.get("transport_delay", {}).get("delay_s", 0.0) + model.hold.until_next * (model.sample_s or 0.0)


def ticks_late(delay_s: float, lag_s: float, dt_s: float) -> float:
    """By how many ticks a force that rises evenly is read late, when every tick holds its voltage.

    A reading at the end of a tick shows the force a whole number of ticks and the part f of a tick after one began. By
    then a step has risen to w = (1 - exp(-f T / lag)) / (1 - exp(-T / lag)) of what it reaches at the tick's end, at
    once without a lag: what is missing, 1 - w, is late by a tick (derived here).
    """
    late = delay_s / dt_s
    whole = math.floor(late)
    into = 1.0 - (late - whole)
    risen = math.expm1(-into * dt_s / lag_s) / math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0
    return whole + 1.0 - risen


def acting_effects(model: Model, without: Collection[str] = ()) -> dict[str, Mapping[str, float]]:
    """Effects that act on every drive, by name; `without` leaves some out."""
    return {one.name: one.parameters for one in model.effects if one.recording is None and one.name not in without}


def refuse(found: Found) -> None:
    """Refuse what has no inverse.

    Raises
    ------
    ModelError
        Names the effect and the reason.
    """
    for name in found:
        if EFFECTS[name].handling == "refused":
            raise ModelError(
                f"{name} cannot be compensated: {EFFECTS[name].why}; drive without it knowingly (bench file: "
                f"compensation_without: [{name}]), or with the model that was identified"
            )


def chain_constants(model: Model, found: Found, dt_s: float) -> Array:
    """The constants of the chain, with its states at 0, shape (FIRST + 4 elements,)."""
    keeps, ramps, weights = _creep(found, dt_s, model.seen_s or math.inf)
    chain = np.zeros(at.FIRST + 4 * weights.size)
    count = weights.size
    for place, values in enumerate((keeps, ramps, weights)):
        chain[at.FIRST + place * count : at.FIRST + (place + 1) * count] = values
    clamp, slew = found.get("voltage_clamp", {}), found.get("slew_limit", {})
    chain[at.LIMIT_V], chain[at.KNEE_V] = clamp.get("limit_V", math.inf), clamp.get("knee_V", 0.0)
    chain[at.SLEW_V] = slew.get("limit_V_per_s", math.inf) * dt_s
    if lag := found.get("electrical_lag"):
        chain[at.LAG_S], chain[at.LAG_SWELL] = lag["time_constant_s"], lag.get("swell", 0.0)
    rate = found.get("rate_dependent_hysteresis", {})
    chain[at.GROWTH], chain[at.KIND] = rate.get("growth", 0.0), round(rate.get("kind", 0.0))
    chain[at.REFERENCE_V_PER_S], chain[at.RATE_WAY_V] = (
        rate.get("reference_V_per_s", 1.0),
        rate.get("rate_way_V", USUAL_DISTANCE_V),
    )
    chain[at.OFFSET_V], chain[at.DT_S] = OFFSET_SHARE * (model.input.high - model.input.low), dt_s
    chain[at.GAIN] = 1.0 + found.get("gain_drift", {}).get("relative_change", 0.0)
    if law := found.get("output_nonlinearity"):
        cube = law.get("cubic", 0.0)
        square = law["curvature"] - cube
        chain[at.SQUARE], chain[at.CUBE] = square, cube
        chain[at.LOW], chain[at.HIGH] = rising(square, cube)
        chain[at.SPAN_N] = model.output.high - model.output.low
    gap = found.get("contact_gap", {})
    chain[at.GAP_N], chain[at.SOFT_N] = gap.get("gap_N", 0.0), gap.get("softness_N", 0.0)
    if "creep" in found and round(found["creep"].get("driven_by", PLAYS)) != PLAYS:
        chain[at.CREEP_BY_VOLTAGE] = _stroke_per_volt(model)
    return chain


def _creep(found: Found, dt_s: float, seen_s: float) -> tuple[Array, Array, Array]:
    """Keep, ramp and weight of every element; a voltage that a lag or a limit smooths runs on through the tick."""
    creep = found.get("creep")
    if creep is None:
        return np.empty(0), np.empty(0), np.empty(0)
    to_s = min(creep["to_s"], MEMORY_S)
    tau_s, weights = spectrum(creep["from_s"], to_s, creep.get("slope", 0.0), seen_s)
    hold = STRAIGHT if "electrical_lag" in found or "slew_limit" in found else HELD_ONE_SAMPLE
    keep, ramp = np.array([first_order_coefficients(one, dt_s, hold.number) for one in tau_s]).T
    return keep, ramp, creep["per_decade"] * weights


def _stroke_per_volt(model: Model) -> float:
    """Chord of the plays' steady major loop: what the voltage that drives a creep is scaled by."""
    operator = model.operator()
    low, high = model.input.low, model.input.high
    _, _, top, bottom = operator.stroke([low, high, high, low])
    return float((top - bottom) / (high - low))


def before_mode(values: Array, frequency_Hz: float, damping_ratio: float, dt_s: float) -> Array:
    """Force in front of a mode, one a tick and held, behind which the readings follow `values`; the ends rest.

    Held, y(k) + a1 y(k-1) + a2 y(k-2) = b1 F(k) + b2 F(k-1). The zero -b2 / b1 lies near -1, where its inverse would
    ring for ever; in its place stands the symmetrical filter of `AHEAD_OF_MODE`, right up to a quarter of the rate.
    """
    matrix, _, _ = second_order_matrices(frequency_Hz, damping_ratio, dt_s)
    trace, determinant = float(np.trace(matrix)), float(np.linalg.det(matrix))
    padded = np.pad(values, 2, mode="edge")
    wished = padded[2:] - trace * padded[1:-1] + determinant * padded[:-2]
    force = np.convolve(np.pad(wished, (1, 2), mode="edge"), AHEAD_OF_MODE, mode="valid")
    result: Array = force[: values.size] / (1.0 - trace + determinant)
    return result
