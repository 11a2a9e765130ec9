"""Where an effect acts: the place that its parameters name."""

from collections.abc import Mapping, Sequence

import numpy as np

from piezod.diagnose.findings import Place
from piezod.diagnose.hypothesis.chain import Chain, Term
from piezod.diagnose.hypothesis.series import Series


def place_of(term: Term, values: Mapping[str, float], chain: Chain) -> tuple[Place, ...]:
    """Places of a fitted effect, none where it acts everywhere.

    Parameters
    ----------
    term
        Effect, and the recording for one that happened once.
    values
        Of its parameters.
    chain
        Recordings.
    """
    asked = [one for one in chain.series if one.role == "recording"]
    acts_in = chain.series[term.series] if term.scope == "once" else asked[0]
    start_s, end_s = acts_in.start_s, acts_in.start_s + acts_in.duration_s
    longest_s = max(one.duration_s for one in asked)
    name = term.effect.name
    ranges: dict[str, tuple[str, float | str, float | str]] = {
        "slew_limit": ("rate_V_per_s", "limit_V_per_s", _fastest(asked)),
        "voltage_clamp": ("voltage_V", "limit_V", max(float(one.command_V.max()) for one in asked)),
        "resonance": ("frequency_Hz", "frequency_Hz", "frequency_Hz"),
        "vibration": ("frequency_Hz", "frequency_Hz", "frequency_Hz"),
        "mains_hum": ("frequency_Hz", "frequency_Hz", "frequency_Hz"),
        "sensor_filter": ("frequency_Hz", "cutoff_Hz", 0.5 / asked[0].dt_s),
        "creep": ("history_s", "from_s", longest_s),
        "charge_leakage": ("history_s", "time_constant_s", longest_s),
        "contact_gap": ("force_N", 0.0, "gap_N"),
        "gain_drift": ("time_s", start_s, end_s),
        "thermal_drift": ("time_s", start_s, end_s),
        "clock_skew": ("time_s", start_s, end_s),
    }
    if name == "load_step":
        return (Place("time_s", start_s + values["on_s"], min(start_s + values["off_s"], end_s)),)
    if name not in ranges:
        return ()
    axis, *ends = ranges[name]
    low, high = (values[end] if isinstance(end, str) else end for end in ends)
    return (Place(axis, low, max(low, high)),)


def _fastest(asked: Sequence[Series]) -> float:
    return max(float(np.abs(np.diff(one.command_V)).max()) / one.dt_s for one in asked)
