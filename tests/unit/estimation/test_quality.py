"""Warnings about a recording: irregular time, gaps, missing, frozen and clipped samples."""

import numpy as np
import pytest

from piezod.estimation.recordings.quality import describe_missing, describe_stuck, describe_timing
from piezod.estimation.recordings.stuck import find_stuck
from piezod.recording import Recording, read_recording
from tests.unit.recording.formats import REAL


def noisy(n=2000, dt_s=0.01):
    rng = np.random.default_rng(3)
    time_s = np.arange(n) * dt_s
    channels = {"voltage_V": 50 + 40 * np.sin(time_s), "force_N": 100 * np.sin(time_s) + rng.normal(size=n)}
    return Recording(time_s, channels, {}, "rec.csv")


def stuck(recording, name, drive):
    return find_stuck(recording.channel(name), recording.channel(drive))


def describe(recording, name, drive="voltage_V"):
    """All lines about the timing and one channel."""
    found = stuck(recording, name, drive)
    return [
        *describe_timing(recording),
        *describe_missing(recording, name),
        *describe_stuck(recording, name, found),
    ]


def test_a_complete_recording_has_no_warning():
    assert describe(noisy(), "force_N") == []


def test_missing_samples_are_nan():
    recording = noisy()
    recording.channels["force_N"][[7, 9]] = np.nan
    assert np.flatnonzero(recording.missing("force_N")).tolist() == [7, 9]
    assert describe(recording, "force_N") == ["force_N: 2 samples missing (0.1 %), the first at 0.07 s"]


def test_a_reading_that_is_constant_while_its_drive_moves_is_frozen():
    recording = noisy()
    recording.channels["force_N"][500:560] = recording.channels["force_N"][500]
    assert stuck(recording, "force_N", "voltage_V").frozen == [(500, 560)]
    (line,) = describe(recording, "force_N")
    assert line.startswith("force_N: constant while its drive moves, in 1 stretch, the longest of 60 samples from 5")


def test_a_reading_is_not_frozen_while_its_drive_is_constant_too():
    recording = noisy()
    for values in recording.channels.values():
        values[500:560] = values[500]
    assert stuck(recording, "force_N", "voltage_V").stretches == []


def test_a_constant_command_causes_no_warning_about_the_reading():
    recording = noisy()
    recording.channels["voltage_V"][500:900] = 77.0
    assert describe(recording, "force_N") == []


def test_runs_at_the_extreme_values_are_clipped():
    recording = noisy()
    force_N = recording.channels["force_N"]
    cut = force_N > 80
    force_N[cut] = 80.0
    stretches = stuck(recording, "force_N", "voltage_V").at_largest
    assert stretches
    assert all((force_N[start:stop] == 80.0).all() and stop - start >= 5 for start, stop in stretches)
    assert any("clipped at its largest value 80" in line for line in describe(recording, "force_N"))


def test_a_flag_and_a_constant_are_not_clipped():
    flag = np.repeat([0.0, 1.0, 0.0], 100)
    recording = Recording(np.arange(300.0), {"on": flag, "zero_V": np.zeros(300), "ramp_V": np.arange(300.0)})
    assert stuck(recording, "on", "ramp_V").stretches == []
    assert stuck(recording, "zero_V", "ramp_V").stretches == []


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is absent")
def test_the_missing_rows_of_a_measured_recording_are_found():
    recording = read_recording(REAL / "pneumatic-friction" / "circle_5bar.csv")
    assert not recording.uniform
    lines = describe_timing(recording)
    assert lines[0].startswith("time_s: irregular, periods of 0.01 to 0.277 s, median 0.01 s")
    assert "3 gaps longer than 5 periods, 0 to 0.277 s" in lines[1]
    assert recording.resampled(0.01).missing("force_N").sum() >= 26


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is absent")
@pytest.mark.parametrize("name", ["identification", "tracking"])
def test_a_complete_measured_recording_has_no_warning(name):
    recording = read_recording(REAL / "piezo-flexure" / f"{name}.csv")
    assert recording.uniform
    assert describe(recording, "displacement_um") == []
