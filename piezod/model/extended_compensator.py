"""The compensator of a model with effects: the inverse of the chain, and the lead of a reference known ahead."""

import math
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod import effects
from piezod.effects.kernels import second_order_matrices
from piezod.model.chain_array import STATE, chain_array
from piezod.model.compensated import ActingEffects, acting_effects, refuse_uncompensated
from piezod.model.inverse_chain import commit_chain_step, force_of, plan_chain_step, start_chain
from piezod.model.law_inverse import law_inverse
from piezod.model.parameters import Model
from piezod.operators import ImplicitInverse
from piezod.operators.compiled_cache import OPERATORS, forget_outdated_steps

Array = NDArray[np.float64]

LARGEST_CHANGE_K = 50.0  # a larger change of the temperature is taken for a fault of its sensor
HALF_SAMPLE_LEAD = np.array([-0.125, 0.625, 0.625, -0.125])  # filter with a flat gain to second order: derived here
CALLED = (OPERATORS, Path(effects.__file__).parent, Path(__file__).parent)  # sources that the compiled steps use


class ExtendedCompensator:
    """Inverse of a model with its effects.

    Parameters
    ----------
    model
        Identified or diagnosed model. Effects that belong to a single recording do not act.
    dt_s
        Tick period [s].
    without
        Names of effects that are deliberately not compensated.

    Attributes
    ----------
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    dt_s
        Tick period [s].

    Raises
    ------
    ModelError
        The model or one of its effects has no inverse; the message names the effect, the reason and the remedy.
    """

    def __init__(self, model: Model, dt_s: float, without: Collection[str] = ()) -> None:
        self._model = model
        acting = acting_effects(model, without)
        refuse_uncompensated(acting)
        forget_outdated_steps(plan_chain_step.stats.cache_path, CALLED)
        self._chain = chain_array(model, acting, dt_s)
        self._packed = ImplicitInverse(model.operator()).packed
        self.delay_s = _delay_s(model, acting, without)
        self._lag_s = acting.get("electrical_lag", {}).get("time_constant_s", 0.0)
        self._resonance = acting.get("resonance")
        thermal = acting.get("thermal_drift", {})
        self._force_per_K = thermal.get("coefficient_N_per_K", 0.0)
        lag_s = thermal.get("lag_s", 0.0)
        self._temperature_gain = -math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0
        self._first_C = self._temperature_C = math.nan
        self._zones = np.concatenate(model.operator().dead_zones)
        self.dt_s = dt_s
        self._law = law_inverse(model, dt_s, self._packed, self._chain, without)
        start_chain(self._packed, self._chain)

    def reset(self) -> None:
        """Return to the model's start state at rest; the next temperature is that of the start."""
        self._packed[:] = ImplicitInverse(self._model.operator()).packed
        start_chain(self._packed, self._chain)
        self._first_C = self._temperature_C = math.nan
        if self._law is not None:
            self._law.reset()

    def plan(self, reference: float) -> float:
        """Voltage [V] for the force `reference` [N] at the end of the tick; changes no state."""
        if self._law is not None:
            return self._law.plan(reference)
        return plan_chain_step(self._packed, self._chain, reference)

    def commit(self, voltage_V: float) -> None:
        """Advance every state with the voltage `voltage_V` [V] that was written."""
        if self._law is not None:
            self._law.commit(voltage_V)
        else:
            commit_chain_step(self._packed, self._chain, voltage_V)

    def produced_N(self) -> float:
        """Force that the voltages written give by the model, before the resonance [N]."""
        added_N = 0.0 if self._law is None else self._law.added_N
        return force_of(self._packed, self._chain, self._zones) + added_N

    def update_temperature(self, temperature_C: float) -> None:
        """Update the thermal drift with a temperature [degC]; an invalid temperature is ignored."""
        if math.isnan(self._first_C) and math.isfinite(temperature_C):
            self._first_C = self._temperature_C = temperature_C
        if not abs(temperature_C - self._first_C) <= LARGEST_CHANGE_K:
            return
        self._temperature_C += self._temperature_gain * (temperature_C - self._temperature_C)
        self._chain[STATE.thermal_N] = self._force_per_K * (self._temperature_C - self._first_C)

    @property
    def compensates_law(self) -> bool:
        """Whether an unnamed law of the model is compensated."""
        return self._law is not None

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Arrays that the steps of `inverse_chain` change: the operator's packed array and the chain array."""
        return self._packed, self._chain

    @property
    def preview_s(self) -> float:
        """Time by which a reference must be known ahead for the complete lead [s]."""
        return self.delay_s + (2.0 * self.dt_s if self._resonance else 0.0)

    @property
    def late_s(self) -> float:
        """Time by which readings follow a reference that is not known ahead: delay, and delay of the resonance [s]."""
        late_s = ticks_late(self.delay_s, self._lag_s, self.dt_s) * self.dt_s
        if self._resonance is not None:
            late_s += self._resonance["damping_ratio"] / (math.pi * self._resonance["frequency_Hz"])
        return late_s

    @property
    def preview_ticks(self) -> int:
        """Time by which a reference must be known ahead [ticks], rounded up."""
        return math.ceil(self.preview_s / self.dt_s)

    def ahead(self, values: Array, *, loop: bool) -> Array:
        """Force to plan for, so that the readings follow `values`: led by the delay, with the resonance inverted.

        Parameters
        ----------
        values
            Reference known ahead, one value a tick, shape (N,) [N].
        loop
            Whether the values begin again at the end; otherwise the last value is held.
        """
        if self.preview_s == 0.0:
            return values
        margin = self.preview_ticks + 3
        wide = np.pad(values, margin, mode="wrap" if loop else "edge")
        ticks = np.arange(wide.size, dtype=np.float64)
        if self.delay_s > 0.0:
            wide = np.interp(ticks + ticks_late(self.delay_s, self._lag_s, self.dt_s), ticks, wide)
        if self._resonance is not None:
            wide = invert_resonance(wide, self._resonance["frequency_Hz"], self._resonance["damping_ratio"], self.dt_s)
        return wide[margin:-margin]


def _delay_s(model: Model, acting: ActingEffects, without: Collection[str]) -> float:
    """Time from the end of a tick, until which its voltage is held, to the reading that shows its force [s].

    A part of the delay is in the sampling of the recording: the time from a reading to the next command. A held command
    that was fitted as a straight command arrives half a sample early in the fit.
    """
    if "transport_delay" in without:
        return 0.0
    return acting.get("transport_delay", {}).get("delay_s", 0.0) + model.hold.until_next * (model.sample_s or 0.0)


def ticks_late(delay_s: float, lag_s: float, dt_s: float) -> float:
    """Delay of the readings of a steadily rising force, when every tick holds its voltage [ticks].

    A reading shows the force at the fraction f of an earlier tick. By then the step of that tick has risen to the share
    w of its value at the end of the tick. The share 1 - w arrives one tick later. Without a lag w = 1; with a lag

        w = (1 - exp(-f T / lag)) / (1 - exp(-T / lag))     (derived here)

    Parameters
    ----------
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    lag_s
        Time constant of the electrical lag [s]; 0 without a lag.
    dt_s
        Tick period T [s].
    """
    late = delay_s / dt_s
    whole = math.floor(late)
    into = 1.0 - (late - whole)
    risen = math.expm1(-into * dt_s / lag_s) / math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0
    return whole + 1.0 - risen


def invert_resonance(values: Array, frequency_Hz: float, damping_ratio: float, dt_s: float) -> Array:
    """Force before a resonance, held for a tick each, that makes the readings follow `values`; shape (N,) [N].

    For a held force, y(k) + a1 y(k-1) + a2 y(k-2) = b1 F(k) + b2 F(k-1). The zero -b2 / b1 lies near -1, so its inverse
    would oscillate without end. The symmetrical filter `HALF_SAMPLE_LEAD` replaces it, accurate up to a quarter of the
    tick rate. Derived here.

    Parameters
    ----------
    values
        Readings to reach, one a tick, shape (N,) [N]; constant before the first and after the last.
    frequency_Hz, damping_ratio
        Undamped natural frequency [Hz] and damping ratio [1] of the resonance.
    dt_s
        Tick period [s].
    """
    matrix, _, _ = second_order_matrices(frequency_Hz, damping_ratio, dt_s)
    trace, determinant = float(np.trace(matrix)), float(np.linalg.det(matrix))
    padded = np.pad(values, 2, mode="edge")
    driven = padded[2:] - trace * padded[1:-1] + determinant * padded[:-2]
    force = np.convolve(np.pad(driven, (1, 2), mode="edge"), HALF_SAMPLE_LEAD, mode="valid")
    result: Array = force[: values.size] / (1.0 - trace + determinant)
    return result
