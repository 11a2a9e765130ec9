"""Drives beyond a resonance: the reading lags by more than half a turn, and no column is swapped."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.estimation.recordings.intake import usable
from piezod.estimation.recordings.suitability import check_suitable
from piezod.recording import Recording

RATE_HZ, DAMPING = 1000.0, 0.1
TIME_S = np.arange(0.0, 8.0, 1.0 / RATE_HZ)


def multisine(low_Hz, high_Hz):
    rng = np.random.default_rng(2)
    lines_Hz = np.arange(low_Hz, high_Hz, 0.25)
    shape = sum(np.cos(2 * np.pi * (f * TIME_S + rng.uniform())) for f in lines_Hz)
    return 50.0 + 30.0 * shape / np.abs(shape).max()


def chirp(low_Hz, high_Hz):
    phase = low_Hz * TIME_S + 0.5 * (high_Hz - low_Hz) / TIME_S[-1] * TIME_S**2
    return 50.0 - 40.0 * np.cos(2 * np.pi * phase)


def sines(low_Hz, high_Hz):
    return 50.0 - 15.0 * np.cos(2 * np.pi * low_Hz * TIME_S) - 15.0 * np.cos(2 * np.pi * high_Hz * TIME_S)


def resonant(u, mode_Hz):
    """Plays, then two modes behind each other by their equations of motion, two steps a sample, and noise."""
    play, modes, out = 0.0, [[2 * np.pi * f, 0.0, 0.0] for f in (mode_Hz, 1.3 * mode_Hz)], np.empty(u.size)
    for k, now in enumerate(u - u[0]):
        play = min(max(play, now - 5.0), now + 5.0)
        for _ in range(2):
            drive = 0.5 * now + 0.5 * play
            for mode in modes:
                w, x, v = mode
                v += 0.5 / RATE_HZ * (w * w * (drive - x) - 2 * DAMPING * w * v)
                mode[1:] = x + 0.5 / RATE_HZ * v, v
                drive = mode[1]
        out[k] = 2.0 * drive
    return out + np.random.default_rng(7).normal(0.0, 0.05, u.size)


DRIVES = {
    "multisine through its modes": (multisine(1.0, 60.0), 7.2),
    "chirp beyond its mode": (chirp(1.0, 80.0), 30.0),
    "two sines about its mode": (sines(1.0, 40.0), 25.0),
}


def checked(u, y):
    recording = Recording(TIME_S, {"voltage_V": u, "force_N": y}, {}, "some.csv")
    return check_suitable(usable(recording, "voltage_V", "force_N", "").recording, "voltage_V", "force_N")


@pytest.mark.parametrize(("u", "mode_Hz"), DRIVES.values(), ids=DRIVES)
def test_a_reading_beyond_its_resonance_is_not_taken_for_the_command(u, mode_Hz):
    assert not any("swapped" in line or "leads" in line for line in checked(u, resonant(u, mode_Hz)))


@pytest.mark.parametrize(
    ("u", "mode_Hz"), [(multisine(1.0, 60.0), 7.2), (chirp(1.0, 80.0), 30.0), (sines(0.5, 3.0), 200.0)]
)
def test_columns_that_are_swapped_are_told_behind_a_resonance_too(u, mode_Hz):
    """Refused where the force is surely measured, else asked about."""
    try:
        said = checked(resonant(u, mode_Hz), u)
    except RecordingError as error:
        said = [str(error)]
    assert any("leads" in line for line in said)
