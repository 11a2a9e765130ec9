"""`Recording`: uniform time, sample period, resampling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import Recording


def noisy(n=2000, dt_s=0.01):
    rng = np.random.default_rng(3)
    time_s = np.arange(n) * dt_s
    channels = {"voltage_V": 50 + 40 * np.sin(time_s), "force_N": 100 * np.sin(time_s) + rng.normal(size=n)}
    return Recording(time_s, channels, {}, "rec.csv")


@pytest.mark.parametrize(("jitter", "uniform"), [(0.0, True), (0.009, True), (0.011, False)])
def test_time_is_uniform_within_one_percent(jitter, uniform):
    time_s = np.arange(100) * 0.5
    time_s[50] += jitter * 0.5
    assert Recording(time_s, {}).uniform is uniform


def test_resampling_is_linear_and_leaves_gaps_empty():
    time_s = np.array([0.0, 1.0, 2.0, 3.0, 13.0, 14.0, 15.0])
    recording = Recording(time_s, {"force_N": 2 * time_s})
    again = recording.resampled(0.5)
    assert again.uniform
    assert again.time_s[-1] == 15.0
    inside = (again.time_s > 3) & (again.time_s < 13)
    assert again.missing("force_N").tolist() == inside.tolist()
    np.testing.assert_allclose(again.channel("force_N")[~inside], 2 * again.time_s[~inside])


def test_resampling_bridges_a_short_hole_but_not_a_long_one():
    recording = noisy(100, 1.0)
    force_N = recording.channels["force_N"]
    force_N[10:14] = force_N[40:45] = np.nan  # pauses of 5 and 6 periods
    missing = recording.resampled(1.0).missing("force_N")
    assert np.flatnonzero(missing).tolist() == [40, 41, 42, 43, 44]


@given(n=st.integers(2, 400), dt_s=st.floats(1e-6, 10), start_s=st.floats(-1e3, 1e3))
def test_resampling_at_its_own_period_changes_nothing(n, dt_s, start_s):
    time_s = start_s + np.arange(n) * dt_s
    recording = Recording(time_s, {"force_N": np.arange(n, dtype=float)})
    again = recording.resampled(dt_s)
    assert again.time_s.size == n
    np.testing.assert_allclose(again.channel("force_N"), recording.channel("force_N"), atol=1e-6)


@pytest.mark.parametrize(("dt_s", "message"), [(0, "above 0"), (-1, "above 0"), (np.nan, "above 0"), (1e-12, "longer")])
def test_an_impossible_period_is_refused(dt_s, message):
    with pytest.raises(RecordingError, match=message):
        noisy().resampled(dt_s)


def test_one_sample_has_no_period():
    with pytest.raises(RecordingError, match="has 1 samples, a sample period needs 2"):
        _ = Recording(np.zeros(1), {}).dt_s
