"""The catalogue's 22 effects as the maker draws them: parameters, plausible ranges, what the plant needs, and places.

Of every effect one parameter is its strength; it is found later, between two bounds. All others are drawn here. Names
and units of parameters are those of the catalogue; a detail is what this plant adds and no one is asked for.

Definitions: `time_constant_s` is that at half range; `growth` the rise of all widths, in parts of themselves, with the
natural logarithm of the rate far above the reference; `share` the part of the irreversible stroke; `per_decade` the
slope of the unit step's response between `from_s` and `to_s`; `relative_change` the gain at a record's end over that at
its beginning, less 1, anew in every record; `curvature` c of the nearest law g (x + c x^2) over the relative force x;
`presliding_N` the travel, in force, after which 63 % of the friction is there; `amplitude_N` that of the fundamental;
`cutoff_Hz` is at -3 dB; `skew_ppm` is above 0 when the reader samples late, ever later.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.creep import LAWS
from firmware_sim.concealed.plant.mechanics import BENDS
from firmware_sim.concealed.plant.passage import Effect
from firmware_sim.concealed.plant.stroke import COURSES

SHORTEST_SAMPLES = 1.5  # of a lag, filter or delay: below it the three are one and the same
DELAY_SAMPLES = 2.0
RAMP_SAMPLES = 4  # a limit that is left within fewer looks like a lag
STEEPEST = 0.6  # of friction against its presliding travel
MAINS_HZ = (50.0, 60.0)

THERE, SINCE = "already_there", "come_since"
EITHER = (THERE, SINCE)


@dataclass(frozen=True)
class Context:
    """What an effect's ranges depend on.

    Parameters
    ----------
    reach_V, full_N
        Ranges [V], [N].
    rate_Hz
        Readings a second [1/s].
    noise_N
        Noise rms [N].
    duration_s
        Of the first recording [s].
    fastest_V_per_s, lasting_V_per_s
        Largest rate of its commands, from one sample to the next and over `RAMP_SAMPLES` [V/s].
    """

    reach_V: float
    full_N: float
    rate_Hz: float
    noise_N: float
    duration_s: float
    fastest_V_per_s: float
    lasting_V_per_s: float

    @property
    def period_s(self) -> float:
        """Sample period [s]."""
        return 1.0 / self.rate_Hz


Draw = Callable[[np.random.Generator, Context], tuple[dict[str, float], dict[str, object]]]


@dataclass(frozen=True)
class Entry:
    """How one effect is drawn.

    Parameters
    ----------
    scale
        The parameter (or, with a leading `:`, the detail) that its strength is set by.
    bounds
        Least and greatest plausible value of it.
    draw
        Everything else.
    scopes
        Where it makes sense: what a static model identified on it would contain already can only have come since.
    straight
        Needs commands that are not held: behind held ones its parameter would not be defined to better than a sample.
    signed
        The strength is a size; its sign is drawn.
    plausible
        Whether an effect can be, once its strength is known.
    """

    scale: str
    bounds: Callable[[Context], tuple[float, float]]
    draw: Draw
    scopes: tuple[str, ...] = EITHER
    straight: bool = False
    signed: bool = False
    plausible: Callable[[Effect], bool] = lambda effect: True  # noqa: ARG005

    def effect(self, name: str, scope: str, drawn: tuple[dict[str, float], dict[str, object]], scale: float) -> Effect:
        """The effect at a strength."""
        parameters, details = dict(drawn[0]), dict(drawn[1])
        sign = -1.0 if self.signed and details.pop("negative") else 1.0
        if self.scale.startswith(":"):
            details[self.scale[1:]] = scale
        else:
            parameters[self.scale] = sign * scale
        return Effect(name, parameters, details, scope)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Evenly on a logarithm."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _nothing(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del rng, at
    return {}, {}


def _signed(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {}, {"negative": bool(rng.random() < 0.5)}


def _lag(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {}, {"swell": rng.uniform(0.0, 0.05)}


def _clamp(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"knee_V": _between(rng, 0.0005, 0.004) * at.reach_V}


def _rate(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {"reference_V_per_s": _between(rng, 0.02, 0.5) * at.reach_V}, {}


def _creep(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    from_s = max(_between(rng, 0.02, 0.5), 3.0 * at.period_s)
    to_s = _between(rng, 30.0, 1000.0)
    return {"from_s": from_s, "to_s": to_s}, {"law": str(rng.choice(LAWS)), "shape": rng.uniform()}


def _gain(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {}, {"negative": bool(rng.random() < 0.6), "course": str(rng.choice(COURSES)), "bend": rng.uniform()}


def _bend(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {}, {"negative": bool(rng.random() < 0.5), "shape": str(rng.choice(BENDS))}


def _gap(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"softness_N": _between(rng, 0.001, 0.01) * at.full_N}


def _friction(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {"presliding_N": _between(rng, 0.01, 0.2) * at.full_N}, {"break_away": rng.uniform(0.1, 0.6)}


def _never_turns_back(effect: Effect) -> bool:
    """Whether the friction grows more slowly than the force that moves: else the reading would fall as that rises."""
    return effect.parameters["force_N"] <= STEEPEST * effect.parameters["presliding_N"]


def _wider_than_soft(effect: Effect) -> bool:
    """Whether there is a gap at all beside the softness of touching."""
    return effect.parameters["gap_N"] >= 2.0 * effect.number("softness_N")


def _resonance(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {"damping_ratio": _between(rng, 0.01, 0.3)}, {}


def _thermal(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    lag_s = _between(rng, 0.3, 2.0) if rng.random() < 0.3 else 0.0
    return {}, {"negative": bool(rng.random() < 0.4), "lag_s": lag_s}


def _load(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    on_s = rng.uniform(0.1, 0.75) * at.duration_s
    parameters = {"on_s": on_s}
    if rng.random() < 0.7:
        parameters["off_s"] = on_s + rng.uniform(0.1, 0.9) * (at.duration_s - on_s)
    return parameters, {"negative": bool(rng.random() < 0.5), "rise_s": _between(rng, 0.001, 0.03)}


def _vibration(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    def mains(f: float) -> bool:
        return any(abs(f - order * m) < 1.5 for m in MAINS_HZ for order in (0.5, 1, 2, 3))

    frequency_Hz = 50.0
    while mains(frequency_Hz):
        frequency_Hz = _between(rng, 4.0, 0.4 * at.rate_Hz)
    return {"frequency_Hz": frequency_Hz}, {"breathing": rng.uniform(0.0, 0.12), "breath_s": rng.uniform(5.0, 40.0)}


def _feedthrough(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    return {}, {"negative": bool(rng.random() < 0.2), "window_s": rng.uniform(0.2, 0.9) * at.period_s}


def _hum(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    harmonics = {str(order): rng.uniform(0.03, 0.4) for order in (2, 3, 4, 5, 7) if rng.random() < 0.5}
    details = {"harmonics": harmonics, "stray_rad": rng.uniform(0.0, 0.08), "stray_s": rng.uniform(5.0, 30.0)}
    return {"frequency_Hz": float(rng.choice(MAINS_HZ)) + rng.uniform(-0.04, 0.04)}, details


def _filter(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    del at
    return {}, {"order": int(rng.choice([1, 2], p=[0.65, 0.35])), "damping_ratio": float(rng.choice([0.7071, 0.866]))}


def _dropout(rng: np.random.Generator, at: Context) -> tuple[dict[str, float], dict[str, object]]:
    """Starts in separate parts of the record, and how the total time frozen is shared out."""
    count = int(rng.integers(1, 5))
    starts = (np.arange(count) + rng.uniform(0.15, 0.6, count)) / count * at.duration_s
    shares = rng.dirichlet(np.full(count, 5.0))
    return {}, {"starts_s": starts.tolist(), "shares": shares.tolist()}


ENTRIES: dict[str, Entry] = {
    "electrical_lag": Entry("time_constant_s", lambda at: (SHORTEST_SAMPLES * at.period_s, 0.15), _lag),
    "slew_limit": Entry(
        "limit_V_per_s", lambda at: (0.3 * at.reach_V, min(200.0 * at.reach_V, 0.98 * at.lasting_V_per_s)), _nothing
    ),
    "voltage_clamp": Entry("limit_V", lambda at: (0.55 * at.reach_V, 0.985 * at.reach_V), _clamp),
    "rate_dependent_hysteresis": Entry("growth", lambda at: (0.002, 0.2), _rate),  # noqa: ARG005
    "noncongruent_minor_loops": Entry("share", lambda at: (0.005, 1.0), _nothing),  # noqa: ARG005
    "creep": Entry("per_decade", lambda at: (0.0003, 0.05), _creep),  # noqa: ARG005
    "gain_drift": Entry("relative_change", lambda at: (0.0003, 0.25), _gain, (SINCE,), signed=True),  # noqa: ARG005
    "output_nonlinearity": Entry("curvature", lambda at: (0.0005, 0.24), _bend, (SINCE,), signed=True),  # noqa: ARG005
    "contact_gap": Entry(
        "gap_N", lambda at: (0.003 * at.full_N, 0.35 * at.full_N), _gap, (SINCE,), plausible=_wider_than_soft
    ),
    "friction": Entry(
        "force_N", lambda at: (0.0003 * at.full_N, 0.08 * at.full_N), _friction, (SINCE,), plausible=_never_turns_back
    ),
    "resonance": Entry("frequency_Hz", lambda at: (5.0, 0.35 * at.rate_Hz), _resonance),
    "thermal_drift": Entry(
        "coefficient_N_per_K", lambda at: (1e-5 * at.full_N, 0.06 * at.full_N), _thermal, signed=True
    ),
    "load_step": Entry("step_N", lambda at: (1e-4 * at.full_N, 0.3 * at.full_N), _load, (SINCE,), signed=True),
    "vibration": Entry("amplitude_N", lambda at: (1e-5 * at.full_N, 0.12 * at.full_N), _vibration),
    "charge_leakage": Entry("time_constant_s", lambda at: (1.0, 3000.0), _nothing),  # noqa: ARG005
    "sensor_filter": Entry("cutoff_Hz", lambda at: (0.8, at.rate_Hz / (2.0 * math.pi * SHORTEST_SAMPLES)), _filter),
    "feedthrough": Entry(
        "coefficient_N_s_per_V",
        lambda at: (1e-8 * at.full_N, 0.05 * at.full_N / at.reach_V),
        _feedthrough,
        straight=True,
        signed=True,
    ),
    "mains_hum": Entry("amplitude_N", lambda at: (1e-5 * at.full_N, 0.12 * at.full_N), _hum),
    "sensor_dropout": Entry(
        ":total_s", lambda at: (max(0.05, 12.0 * at.period_s), 0.15 * at.duration_s), _dropout, (SINCE,)
    ),
    "quantisation": Entry("step_N", lambda at: (0.5 * at.noise_N, 0.05 * at.full_N), _nothing),
    "transport_delay": Entry("delay_s", lambda at: (DELAY_SAMPLES * at.period_s, 0.08), _nothing, straight=True),
    "clock_skew": Entry("skew_ppm", lambda at: (20.0, 4000.0), _signed, straight=True, signed=True),  # noqa: ARG005
}

TONES = frozenset({"vibration", "mains_hum"})
ONCE = frozenset({"load_step", "sensor_dropout"})
UNREPEATABLE = TONES | ONCE | {"quantisation"}
"""Effects that another record does not repeat sample by sample; the target of the held-out figures is without them."""


def frozen_places(effect: Effect) -> list[tuple[float, float]]:
    """Stretches [s] of the first recording in which the reading stands still."""
    starts, shares = effect.details["starts_s"], effect.details["shares"]
    assert isinstance(starts, list)
    assert isinstance(shares, list)
    total_s = effect.number("total_s")
    return [(start, start + share * total_s) for start, share in zip(starts, shares, strict=True)]


def places(effect: Effect, context: Context) -> list[dict[str, object]]:
    """Where an effect is to be found, in the form of the findings' PLACE; empty when it is everywhere."""
    p = effect.parameters
    if effect.name == "sensor_dropout":
        return [_place("time_s", *stretch) for stretch in frozen_places(effect)]
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
