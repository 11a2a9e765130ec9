"""The 22 effects of the catalogue: how their parameters are drawn, their plausible ranges and their places.

One parameter of every effect sets its strength. `drawing.py` finds it later, between two bounds. The other parameters
are drawn here. Names and units are those of the catalogue. A detail is a value that this plant adds; no diagnosis
reports it.

Definitions:

- `time_constant_s` of the lag: at half range;
- `growth`: relative rise of all widths per unit of ln(rate), far above the reference rate;
- `share`: share of the irreversible stroke;
- `per_decade`: slope of the step response between `from_s` and `to_s`, relative to the step;
- `relative_change`: gain at the end of a record over the gain at its beginning, less 1, in every record anew;
- `curvature`: c of the nearest law g (x + c x^2) of the relative force x;
- `presliding_N`: travel, in force, after which the friction reaches 63 %;
- `amplitude_N`: amplitude of the fundamental;
- `cutoff_Hz`: at -3 dB;
- `skew_ppm`: above 0 when the readings fall behind the commands with time.
"""

import math

import numpy as np

from firmware_sim.concealed.plant.creep import LAWS
from firmware_sim.concealed.plant.force_law import BENDS
from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.plant.stroke import DRIFT_SHAPES
from firmware_sim.concealed.study.entry import COME_SINCE, Context, Entry

SHORTEST_SAMPLES = 1.5  # shortest lag; a shorter lag equals a filter or a delay
DELAY_SAMPLES = 2.0  # shortest delay
STEEPEST = 0.6  # largest friction / presliding travel
MAINS_HZ = (50.0, 60.0)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a value uniformly in its logarithm."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _nothing(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del rng, bench
    return {}, {}


def _signed(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {}, {"negative": bool(rng.random() < 0.5)}


def _lag(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {}, {"swell": rng.uniform(0.0, 0.05)}


def _clamp(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"knee_V": _log_uniform(rng, 0.0005, 0.004) * bench.reach_V}


def _rate(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {"reference_V_per_s": _log_uniform(rng, 0.02, 0.5) * bench.reach_V}, {}


def _creep(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    from_s = max(_log_uniform(rng, 0.02, 0.5), 3.0 * bench.period_s)
    to_s = _log_uniform(rng, 30.0, 1000.0)
    return {"from_s": from_s, "to_s": to_s}, {"law": str(rng.choice(LAWS)), "shape": rng.uniform()}


def _gain(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {}, {"negative": bool(rng.random() < 0.6), "course": str(rng.choice(DRIFT_SHAPES)), "bend": rng.uniform()}


def _bend(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {}, {"negative": bool(rng.random() < 0.5), "shape": str(rng.choice(BENDS))}


def _gap(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"softness_N": _log_uniform(rng, 0.001, 0.01) * bench.full_N}


def _friction(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {"presliding_N": _log_uniform(rng, 0.01, 0.2) * bench.full_N}, {"break_away": rng.uniform(0.1, 0.6)}


def _never_turns_back(effect: Effect) -> bool:
    """Whether friction grows more slowly than the driving force; otherwise the reading would fall while it rises."""
    return effect.parameters["force_N"] <= STEEPEST * effect.parameters["presliding_N"]


def _wider_than_soft(effect: Effect) -> bool:
    """Whether the gap is wider than twice the softness of the contact."""
    return effect.parameters["gap_N"] >= 2.0 * effect.number("softness_N")


def _resonance(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {"damping_ratio": _log_uniform(rng, 0.01, 0.3)}, {}


def _thermal(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    lag_s = _log_uniform(rng, 0.3, 2.0) if rng.random() < 0.3 else 0.0
    return {}, {"negative": bool(rng.random() < 0.4), "lag_s": lag_s}


def _load(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    on_s = rng.uniform(0.1, 0.75) * bench.duration_s
    parameters = {"on_s": on_s}
    if rng.random() < 0.7:
        parameters["off_s"] = on_s + rng.uniform(0.1, 0.9) * (bench.duration_s - on_s)
    return parameters, {"negative": bool(rng.random() < 0.5), "rise_s": _log_uniform(rng, 0.001, 0.03)}


def _vibration(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    def mains(f: float) -> bool:
        return any(abs(f - order * m) < 1.5 for m in MAINS_HZ for order in (0.5, 1, 2, 3))

    frequency_Hz = 50.0
    while mains(frequency_Hz):
        frequency_Hz = _log_uniform(rng, 4.0, 0.4 * bench.rate_Hz)
    return {"frequency_Hz": frequency_Hz}, {"breathing": rng.uniform(0.0, 0.12), "breath_s": rng.uniform(5.0, 40.0)}


def _feedthrough(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"negative": bool(rng.random() < 0.2), "window_s": rng.uniform(0.2, 0.9) * bench.period_s}


def _hum(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    harmonics = {str(order): rng.uniform(0.03, 0.4) for order in (2, 3, 4, 5, 7) if rng.random() < 0.5}
    details = {"harmonics": harmonics, "stray_rad": rng.uniform(0.0, 0.08), "stray_s": rng.uniform(5.0, 30.0)}
    return {"frequency_Hz": float(rng.choice(MAINS_HZ)) + rng.uniform(-0.04, 0.04)}, details


def _filter(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    del bench
    return {}, {"order": int(rng.choice([1, 2], p=[0.65, 0.35])), "damping_ratio": float(rng.choice([0.7071, 0.866]))}


def _dropout(rng: np.random.Generator, bench: Context) -> tuple[dict[str, float], dict[str, object]]:
    """Draw the starts of the frozen spans, and their shares in the total frozen time."""
    count = int(rng.integers(1, 5))
    starts = (np.arange(count) + rng.uniform(0.15, 0.6, count)) / count * bench.duration_s
    shares = rng.dirichlet(np.full(count, 5.0))
    return {}, {"starts_s": starts.tolist(), "shares": shares.tolist()}


ENTRIES: dict[str, Entry] = {
    "electrical_lag": Entry("time_constant_s", lambda bench: (SHORTEST_SAMPLES * bench.period_s, 0.15), _lag),
    "slew_limit": Entry(
        "limit_V_per_s",
        lambda bench: (0.3 * bench.reach_V, min(200.0 * bench.reach_V, 0.98 * bench.lasting_V_per_s)),
        _nothing,
    ),
    "voltage_clamp": Entry("limit_V", lambda bench: (0.55 * bench.reach_V, 0.985 * bench.reach_V), _clamp),
    "rate_dependent_hysteresis": Entry("growth", lambda bench: (0.002, 0.2), _rate),  # noqa: ARG005
    "noncongruent_minor_loops": Entry("share", lambda bench: (0.005, 1.0), _nothing),  # noqa: ARG005
    "creep": Entry("per_decade", lambda bench: (0.0003, 0.05), _creep),  # noqa: ARG005
    "gain_drift": Entry("relative_change", lambda bench: (0.0003, 0.25), _gain, (COME_SINCE,), signed=True),  # noqa: ARG005
    "output_nonlinearity": Entry("curvature", lambda bench: (0.0005, 0.24), _bend, (COME_SINCE,), signed=True),  # noqa: ARG005
    "contact_gap": Entry(
        "gap_N",
        lambda bench: (0.003 * bench.full_N, 0.35 * bench.full_N),
        _gap,
        (COME_SINCE,),
        plausible=_wider_than_soft,
    ),
    "friction": Entry(
        "force_N",
        lambda bench: (0.0003 * bench.full_N, 0.08 * bench.full_N),
        _friction,
        (COME_SINCE,),
        plausible=_never_turns_back,
    ),
    "resonance": Entry("frequency_Hz", lambda bench: (5.0, 0.35 * bench.rate_Hz), _resonance),
    "thermal_drift": Entry(
        "coefficient_N_per_K", lambda bench: (1e-5 * bench.full_N, 0.06 * bench.full_N), _thermal, signed=True
    ),
    "load_step": Entry(
        "step_N", lambda bench: (1e-4 * bench.full_N, 0.3 * bench.full_N), _load, (COME_SINCE,), signed=True
    ),
    "vibration": Entry("amplitude_N", lambda bench: (1e-5 * bench.full_N, 0.12 * bench.full_N), _vibration),
    "charge_leakage": Entry("time_constant_s", lambda bench: (1.0, 3000.0), _nothing),  # noqa: ARG005
    "sensor_filter": Entry(
        "cutoff_Hz", lambda bench: (0.8, bench.rate_Hz / (2.0 * math.pi * SHORTEST_SAMPLES)), _filter
    ),
    "feedthrough": Entry(
        "coefficient_N_s_per_V",
        lambda bench: (1e-8 * bench.full_N, 0.05 * bench.full_N / bench.reach_V),
        _feedthrough,
        straight=True,
        signed=True,
    ),
    "mains_hum": Entry("amplitude_N", lambda bench: (1e-5 * bench.full_N, 0.12 * bench.full_N), _hum),
    "sensor_dropout": Entry(
        ":total_s", lambda bench: (max(0.05, 12.0 * bench.period_s), 0.15 * bench.duration_s), _dropout, (COME_SINCE,)
    ),
    "quantisation": Entry("step_N", lambda bench: (0.5 * bench.noise_N, 0.05 * bench.full_N), _nothing),
    "transport_delay": Entry("delay_s", lambda bench: (DELAY_SAMPLES * bench.period_s, 0.08), _nothing, straight=True),
    "clock_skew": Entry("skew_ppm", lambda bench: (20.0, 4000.0), _signed, straight=True, signed=True),  # noqa: ARG005
}

TONES = frozenset({"vibration", "mains_hum"})
ONCE = frozenset({"load_step", "sensor_dropout"})
UNREPEATABLE = TONES | ONCE | {"quantisation"}
"""Effects that another record does not repeat sample by sample; the held-out target is computed without them."""


def frozen_spans(effect: Effect) -> list[tuple[float, float]]:
    """Spans (start, end) of the first recording in which the reading is frozen [s].

    Parameters
    ----------
    effect
        Effect `sensor_dropout`.
    """
    starts, shares = effect.details["starts_s"], effect.details["shares"]
    assert isinstance(starts, list)
    assert isinstance(shares, list)
    total_s = effect.number("total_s")
    return [(start, start + share * total_s) for start, share in zip(starts, shares, strict=True)]


def places(effect: Effect, context: Context) -> list[dict[str, object]]:
    """Places of an effect in the form of findings.json; empty when it acts everywhere.

    Parameters
    ----------
    effect
        Effect with its parameters.
    context
        Range, duration and rates of the first recording.
    """
    p = effect.parameters
    if effect.name == "sensor_dropout":
        return [_place("time_s", *span) for span in frozen_spans(effect)]
    if effect.name == "load_step":
        return [_place("time_s", p["on_s"], p.get("off_s", context.duration_s))]
    if effect.name in {"vibration", "mains_hum", "resonance"}:
        return [_place("frequency_Hz", p["frequency_Hz"], p["frequency_Hz"])]
    if effect.name == "slew_limit":
        return [_place("rate_V_per_s", p["limit_V_per_s"], context.fastest_V_per_s)]
    if effect.name == "voltage_clamp":
        return [_place("voltage_V", p["limit_V"], context.reach_V)]
    return []


def _place(axis: str, low: float, high: float) -> dict[str, object]:
    return {"axis": axis, "low": low, "high": high}
