"""Columns for an unknown past: what two pasts differ by lies in them, wherever in time the range grows.

Expected values come from operators that were driven with both pasts.
"""

from pathlib import Path

import numpy as np
import pytest

from piezod.estimation.recordings.unknown_past import fitted_past, unknown_past
from piezod.model import load_model

RATE_Hz = 200.0


@pytest.fixture(scope="module")
def model():
    return load_model(Path(__file__).parents[3] / "config" / "model.yaml")


def courses_of(rng, count=12000):
    """The range grows all the time; in the first second, then hardly; in jumps to alternating ends."""
    time_s = np.arange(count) / RATE_Hz
    growing = 60.0 + np.minimum(time_s, 50.0) * 1.15 * np.sin(2.0 * np.pi * 0.31 * time_s)
    early = 60.0 + np.minimum(50.0 * time_s, 50.0) * np.sin(2.0 * np.pi * 2.3 * time_s)
    early[400:] += 5.0 * np.sin(0.2 * time_s[400:])
    ends = 60.0 + np.array([-1, 1] * 8) * np.linspace(5.0, 55.0, 16)
    jumps = np.concatenate((np.repeat(ends, 25), np.full(count - 400, 50.0)))
    jumps[400:] += 40.0 * np.sin(time_s[400:])
    return {
        "growing": growing,
        "early": early,
        "jumps": jumps,
        "random": np.clip(60.0 + np.cumsum(rng.normal(0.0, 2.0, count)), 0.0, 120.0),
    }


@pytest.mark.parametrize("course", ["growing", "early", "jumps", "random"])
@pytest.mark.parametrize("seed", range(4))
def test_what_two_pasts_differ_by_lies_in_the_columns(model, course, seed):
    rng = np.random.default_rng(seed)
    u = courses_of(rng)[course]
    past = rng.uniform(0.0, 120.0, 5)
    apart_V = driven(model, past, u) - driven(model, (0.0,), u)
    within = 1e-3 * np.ptp(u)
    known = unknown_past(u, model.hysteresis.operator, (0.0, 120.0), within)
    left_V = apart_V - fitted_past(apart_V, known.columns)
    before = slice(0, known.until + 1)
    assert left_V[before].std() < 0.04 * apart_V[before].std()
    assert np.ptp(left_V[known.until :]) < 2.0 * within
    assert known.columns.shape[1] < 40
    left_V -= np.median(left_V[known.known])
    assert np.abs(left_V[known.known]).max() < 2.0 * within


def driven(model, past_V, u):
    operator = model.hysteresis.operator()
    operator.run(np.array(past_V))
    return operator.stroke(u)
