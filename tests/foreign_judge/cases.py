"""Models and commands that the judge and `piezod simulate` both simulate: each effect alone, every hold."""

import tempfile
from pathlib import Path

import numpy as np
import yaml

import piezod
from tests.foreign_judge.law import simulate

DT_S, SAMPLES = 0.01, 400
HOLDS = (
    {"sampling": "straight"},
    {"sampling": "held", "read_after": 1.0},
    {"sampling": "held", "read_after": 0.3},
    {"sampling": "held_before"},
)
HUM = {f"{part}_{h}": 0.3 / h for h in range(2, 8) for part in ("sine", "cosine")}
FADING = {"memory": 0.3, "memory_way": 2.0, "memory_exponent": 1.5, "memory_closing": 0.6}
CURVED = {f"degree_{d}_{j}": 0.1 * (d - 2 * j) / d for d in range(1, 6) for j in range(4)} | {
    f"curve_{d}": 0.04 * (-1) ** d for d in range(2, 6)
}
CASES = {
    "voltage_clamp": [{"limit_V": 100.0, "knee_V": 8.0}],
    "slew_limit": [{"limit_V_per_s": 250.0}],
    "electrical_lag": [{"time_constant_s": 0.03, "swell": swell} for swell in (0.0, 0.8)],
    "rate_dependent_hysteresis": [
        {
            "growth": 0.1,
            "reference_V_per_s": 20.0,
            "rate_way_V": 2.0,
            "rate_memory_s": 0.02,
            "rate_over": over,
            "kind": kind,
        }
        for over in (0.0, 1.0)
        for kind in (0.0, 1.0, 2.0)
    ],
    "noncongruent_minor_loops": [{"share": 1.0} | CURVED | FADING],
    "creep": [
        {"per_decade": 0.02, "from_s": 0.013, "to_s": to, "slope": slope, "driven_by": driver}
        for driver in (0.0, 1.0, 2.0)
        for to, slope in ((100.0, 0.0), (2.5, 0.1))
    ],
    "gain_drift": [
        {"relative_change": 0.2, "bend": bend, "s_shape": shape} for bend, shape in ((0.0, 0.0), (3.0, 0.6), (-2.0, -1))
    ],
    "output_nonlinearity": [{"curvature": c, "cubic": q} for c, q in ((-0.1, 0.05), (0.3, -0.2), (-0.7, 0.0))],
    "contact_gap": [{"gap_N": 30.0, "softness_N": soft} for soft in (0.0, 5.0)],
    "friction": [
        {"force_N": 6.0, "presliding_N": 20.0, "exponent": n, "closing": closing}
        for n, closing in ((1.0, 1.0), (6.0, 0.5), (0.7, 0.4))
    ],
    "thermal_drift": [{"coefficient_N_per_K": 5.0, "lag_s": lag} for lag in (0.0, 0.7)],
    "load_step": [{"step_N": 20.0, "on_s": 1.003, "off_s": 2.5, "rise_s": rise} for rise in (0.0, 0.05)],
    "resonance": [{"frequency_Hz": 15.0, "damping_ratio": zeta} for zeta in (0.03, 1.0)],
    "vibration": [
        {
            "amplitude_N": 4.0,
            "frequency_Hz": 11.0,
            "phase_rad": 0.7,
            "breathing_depth": 0.4,
            "breathing_period_s": 2.0,
            "breathing_phase_rad": 1.1,
        }
    ],
    "charge_leakage": [{"time_constant_s": 1.5}],
    "sensor_filter": [
        {"cutoff_Hz": 8.0, "order": order, "damping_ratio": zeta}
        for order, zeta in ((1.0, 0.7), (2.0, 0.71), (2.0, 1.1))
    ],
    "feedthrough": [{"coefficient_N_s_per_V": 0.02, "rise_s": 0.013}],
    "mains_hum": [{"amplitude_N": 2.0, "frequency_Hz": 50.3, "phase_rad": 0.4} | HUM],
    "transport_delay": [{"delay_s": 0.0137}],
    "clock_skew": [{"skew_ppm": skew} for skew in (9000.0, -9000.0)],
    "sensor_dropout": [{"from_s": 1.003, "to_s": 1.2}, {"from_s": 1.01, "to_s": 1.2}],
    "quantisation": [{"step_N": 0.5, "offset_N": 0.1317}],
}


def recordings():
    """Times, commands and temperatures: steps, ramps, sines and rests, from zero and amid the range."""
    t = np.arange(SAMPLES) * DT_S
    corners = [0.0, 0.2, 0.7, 1.2, 1.9, 2.0, 2.6, 2.601, 3.2, 4.0]
    from_zero = np.interp(t, corners, [0.0, 0.0, 90.0, 30.0, 120.0, 60.0, 110.0, 60.0, 60.0, 80.0])
    amid = 60.0 + 45.0 * np.sin(5.0 * t) * np.cos(1.3 * t)
    amid[150:200] = 75.0
    amid[200:230] = 20.0
    temperature = 21.0 + np.sin(1.7 * t)
    return [(t, from_zero, temperature), (t + 0.5, amid, temperature)]


def model_of(effects, hold):
    """A `model.yaml`, parsed: seven plays, four dead zones and the effects."""
    return {
        "schema": "piezod.model/1",
        "name": "judged",
        "input": {"channel": "voltage_V", "unit": "V", "low": 0.0, "high": 140.0},
        "output": {"channel": "force_N", "unit": "N", "low": 0.0, "high": 300.0},
        "hysteresis": {
            "plays": {
                "thresholds": [0.0, 1.0, 4.0, 10.0, 20.0, 45.0, 90.0],
                "weights": [0.6, 0.08, 0.1, 0.12, 0.1, -0.05, 0.2],
            },
            "dead_zones": {"thresholds": [0.0, 15.0, 40.0, 90.0], "weights": [2.5, -0.3, 0.2, -0.4]},
            "offset": 0.5,
            "eps": 0.01,
        },
        "effects": [{"name": name, "parameters": values} for name, values in effects.items()],
        "start": {"kind": "virgin"},
        "provenance": {"created": "2026-11-21T10:28:01+00:00", "by": "hand", "recordings": [], "fit": {}, "notes": ""},
    } | hold


def by_piezod(model, t, u, temperature):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.yaml"
        path.write_text(yaml.safe_dump(model), encoding="utf-8")
        loaded = piezod.Model.load(path)
    recording = piezod.Recording(t, {"voltage_V": u, "temperature_C": temperature})
    return np.asarray(piezod.simulate(recording, loaded).channels["force_N"])


def difference(model, recording):
    """Largest difference between the judge and piezod [range of the output]."""
    mine, theirs = simulate(model, *recording), by_piezod(model, *recording)
    return float(np.max(np.abs(mine - theirs))) / (model["output"]["high"] - model["output"]["low"])


def differences(name):
    """Largest difference of an effect at each hold, over its cases and the recordings [range]."""
    return [
        max(difference(model_of({name: values}, hold), one) for values in CASES[name] for one in recordings())
        for hold in HOLDS
    ]
