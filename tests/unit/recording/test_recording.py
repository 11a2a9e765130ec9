"""What a recording says of itself: missing, frozen, clipped, irregular; and its parts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import Recording, read_recording
from tests.unit.recording.formats import REAL


def noisy(n=2000, dt_s=0.01):
    rng = np.random.default_rng(3)
    time_s = np.arange(n) * dt_s
    channels = {"voltage_V": 50 + 40 * np.sin(time_s), "force_N": 100 * np.sin(time_s) + rng.normal(size=n)}
    return Recording(time_s, channels, {}, "rec.csv")


def test_nothing_is_noteworthy_about_a_sound_recording():
    assert noisy().quality() == []


def test_missing_samples_are_where_they_are_nan():
    recording = noisy()
    recording.channels["force_N"][[7, 9]] = np.nan
    assert np.flatnonzero(recording.missing("force_N")).tolist() == [7, 9]
    assert recording.quality() == ["force_N: 2 samples missing (0.1 %), the first at 0.07 s"]


def test_a_reading_that_stands_still_while_its_drive_moves_is_frozen():
    recording = noisy()
    recording.channels["force_N"][500:560] = recording.channels["force_N"][500]
    assert recording.stuck("force_N", "voltage_V").frozen == [(500, 560)]
    (line,) = recording.quality()
    assert line.startswith(
        "force_N: stands still while its drive moves, in 1 stretch, the longest of 60 samples from 5"
    )


def test_a_reading_is_not_frozen_while_everything_stands_still():
    recording = noisy()
    for values in recording.channels.values():
        values[500:560] = values[500]
    assert recording.stuck("force_N", "voltage_V").stretches == []


def test_a_hold_of_the_command_is_not_noteworthy():
    recording = noisy()
    recording.channels["voltage_V"][500:900] = 77.0
    assert recording.quality() == []


def test_plateaus_at_the_extremes_are_clipped():
    recording = noisy()
    force_N = recording.channels["force_N"]
    cut = force_N > 80
    force_N[cut] = 80.0
    stretches = recording.stuck("force_N", "voltage_V").at_largest
    assert stretches
    assert all((force_N[start:stop] == 80.0).all() and stop - start >= 5 for start, stop in stretches)
    assert any("clipped at its largest value 80" in line for line in recording.quality())


def test_a_flag_and_a_constant_are_not_clipped():
    flag = np.repeat([0.0, 1.0, 0.0], 100)
    recording = Recording(np.arange(300.0), {"on": flag, "zero_V": np.zeros(300), "ramp_V": np.arange(300.0)})
    assert recording.stuck("on", "ramp_V").stretches == []
    assert recording.stuck("zero_V", "ramp_V").stretches == []


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
    force_N[10:14] = force_N[40:45] = np.nan  # neighbours 5 and 6 periods apart
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


def test_a_window_holds_its_start_and_not_its_end():
    part = noisy(100, 1.0).window(10.0, 20.0)
    assert part.time_s.tolist() == list(range(10, 20))
    with pytest.raises(RecordingError, match="has no samples from 500 s to 600 s"):
        noisy(100, 1.0).window(500, 600)


@given(n=st.integers(2, 100), fraction=st.floats(0.01, 0.99))
def test_a_split_loses_nothing(n, fraction):
    recording = noisy(n)
    if not 0 < round(fraction * n) < n:
        with pytest.raises(RecordingError, match="cannot be split"):
            recording.split(fraction)
        return
    first, rest = recording.split(fraction)
    np.testing.assert_array_equal(np.concatenate([first.time_s, rest.time_s]), recording.time_s)


def test_one_sample_has_no_period():
    with pytest.raises(RecordingError, match="has 1 samples, a sample period needs 2"):
        _ = Recording(np.zeros(1), {}).dt_s


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is absent")
def test_the_rows_missing_in_a_measured_recording_are_found():
    recording = read_recording(REAL / "pneumatic-friction" / "circle_5bar.csv")
    assert not recording.uniform
    lines = recording.quality()
    assert lines[0].startswith("time_s: irregular, periods of 0.01 to 0.277 s, median 0.01 s")
    assert "3 gaps longer than 5 periods, 0 to 0.277 s" in lines[1]
    assert recording.resampled(0.01).missing("force_N").sum() >= 26


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is absent")
@pytest.mark.parametrize("name", ["identification", "tracking"])
def test_a_measured_recording_without_blemish_has_none(name):
    recording = read_recording(REAL / "piezo-flexure" / f"{name}.csv")
    assert recording.uniform
    assert [line for line in recording.quality() if not line.startswith("feedforward_on")] == []
