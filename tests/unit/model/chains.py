"""Models with effects, for the tests of both directions of the chain."""

from pathlib import Path

from piezod.effects import EFFECTS
from piezod.model import load_model
from piezod.model.parameters import EffectValues

DT_S = 1e-3
FOUND = {
    "creep": {"per_decade": 0.02, "from_s": 0.01, "to_s": 100.0},
    "electrical_lag": {"time_constant_s": 0.02},
    "rate_dependent_hysteresis": {"growth": 0.05, "reference_V_per_s": 30.0},
    "output_nonlinearity": {"curvature": -0.08, "cubic": 0.02},
    "voltage_clamp": {"limit_V": 130.0, "knee_V": 10.0},
    "contact_gap": {"gap_N": 20.0, "softness_N": 2.0},
    "resonance": {"frequency_Hz": 60.0, "damping_ratio": 0.05},
    "charge_leakage": {"time_constant_s": 3.0},
    "sensor_filter": {"cutoff_Hz": 20.0},
    "feedthrough": {"coefficient_N_s_per_V": 0.01, "rise_s": 0.003},
    "transport_delay": {"delay_s": 0.007},
    "mains_hum": {"amplitude_N": 2.0, "frequency_Hz": 50.0, "phase_rad": 1.0, "sine_3": 0.3},
}


def held_model():
    """The shipped model, for commands that are held and readings at the end of a tick."""
    shipped = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
    return shipped.model_copy(update={"sampling": "held", "read_after": 1.0})


def with_effects(model, *names, **changed):
    """Model with effects; `changed` replaces the values of parameters of these names."""
    effects = []
    for name in names:
        known = {
            one.name: (one.search.choices or one.search.starts)[0] for one in EFFECTS[name].parameters
        } | FOUND.get(name, {})
        asked = {key: value for key, value in changed.items() if key in known}
        effects.append(EffectValues(name=name, parameters=known | asked))
    return model.model_copy(update={"effects": tuple(effects)})
