"""A change between winter and summer time in local time stamps is named and taken out."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import read_recording
from piezod.recording.formats.repairs import repair_notes

STEP_S = 0.5


def local_file(folder, start, *, change_after, hours, form="%Y-%m-%d %H:%M:%S.%f", rows=400):
    stamps = [start + timedelta(seconds=STEP_S * k, hours=hours * (k > change_after)) for k in range(rows)]
    lines = [f"{stamp.strftime(form)};{k};{100 + k}" for k, stamp in enumerate(stamps)]
    path = folder / "local.csv"
    path.write_text("date;voltage [V];force [N]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    recording = read_recording(path)
    return recording, repair_notes(recording.metadata)


@pytest.mark.parametrize(
    ("start", "hours", "direction"),
    [
        (datetime.fromisoformat("2026-10-25 02:58"), -1, "back"),  # Europe
        (datetime.fromisoformat("2026-03-29 01:58"), 1, "forward"),
        (datetime.fromisoformat("2026-11-01 01:58"), -1, "back"),  # United States
        (datetime.fromisoformat("2026-03-08 01:58"), 1, "forward"),
    ],
)
@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S.%f", "%H:%M:%S.%f"])
def test_a_clock_change_is_taken_out_and_said(tmp_path, start, hours, direction, form):
    recording, notes = local_file(tmp_path, start, change_after=239, hours=hours, form=form)
    np.testing.assert_allclose(recording.time_s, STEP_S * np.arange(400), rtol=0, atol=1e-6)
    assert len(notes) == 1
    assert notes[0].startswith(f"the clock is set {direction} by an hour after 0")


@pytest.mark.parametrize(
    "start", [datetime.fromisoformat("2026-10-25 14:58"), datetime.fromisoformat("2026-10-24 02:58")]
)
def test_an_hour_back_at_another_time_is_no_clock_change(tmp_path, start):
    with pytest.raises(RecordingError, match="time_s must strictly increase"):
        local_file(tmp_path, start, change_after=239, hours=-1)


def test_a_pause_that_is_no_hour_stays(tmp_path):
    recording, notes = local_file(tmp_path, datetime.fromisoformat("2026-03-29 01:58"), change_after=239, hours=0.9)
    assert notes == []
    assert recording.time_s[-1] == pytest.approx(399 * STEP_S + 0.9 * 3600)
