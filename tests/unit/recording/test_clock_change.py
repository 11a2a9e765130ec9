"""A change between winter and summer time in local time stamps is named and taken out."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import TextOptions, read_recording
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


ZONES = ["Z", " UTC", "+01:00", "+0100", "-05", " +05:30", " CET"]


@pytest.mark.parametrize("zone", ZONES)
@pytest.mark.parametrize(
    "form", ["%Y-%m-%dT%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f"]
)
def test_a_time_zone_is_read(tmp_path, zone, form):
    recording, notes = local_file(
        tmp_path, datetime.fromisoformat("2026-11-28 10:00"), change_after=999, hours=0, form=form + zone
    )
    np.testing.assert_allclose(recording.time_s, STEP_S * np.arange(400), rtol=0, atol=1e-6)
    assert notes == []


@pytest.mark.parametrize(("summer", "winter"), [("+02:00", "+01:00"), (" CEST", " CET"), ("-0400", "-0500")])
def test_stamps_with_their_zone_need_no_correction_at_a_clock_change(tmp_path, summer, winter):
    start = datetime.fromisoformat("2026-10-25 02:58")
    lines = []
    for k in range(400):
        stamp = start + timedelta(seconds=STEP_S * k, hours=-1 * (k > 239))
        lines.append(
            f"{stamp.isoformat(sep=' ', timespec='milliseconds')}{winter if k > 239 else summer};{k};{100 + k}"
        )
    path = tmp_path / "zoned.csv"
    path.write_text("date;voltage [V];force [N]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    recording = read_recording(path)
    np.testing.assert_allclose(recording.time_s, STEP_S * np.arange(400), rtol=0, atol=1e-6)
    assert repair_notes(recording.metadata) == []


def test_a_stamp_without_the_zone_of_the_others_is_refused(tmp_path):
    path = tmp_path / "zoned.csv"
    lines = [f"2026-11-28 10:00:{k:02}{'+01:00' if k != 7 else ''};{k};{k}" for k in range(40)]
    path.write_text("date;voltage [V];force [N]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="line 9: 'date' is '2026-11-28 10:00:07', must be a time"):
        read_recording(path)


def test_a_date_and_a_time_of_day_in_two_columns_are_one_time(tmp_path):
    """A pause of two days stays: times of day alone would lose it."""
    path = tmp_path / "two.csv"
    lines = [f"{28 + 2 * (k > 19)}.11.2026;10:00:{k:02},500;{k};{k}" for k in range(40)]
    path.write_text("Datum;Uhrzeit;U [V];F [N]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    time_s = read_recording(path).time_s
    np.testing.assert_allclose(time_s, np.arange(40) + 2 * 86400.0 * (np.arange(40) > 19))


@pytest.mark.parametrize(("unit_s", "start"), [(1.0, 1795700000), (1e-3, 1795700000123), (1e-9, 1795700000123456789)])
def test_whole_times_since_1970_are_read_by_their_size(tmp_path, unit_s, start):
    path = tmp_path / "epoch.csv"
    step = round(2.0 / unit_s)
    lines = [f"{start + k * step},{k},{k}" for k in range(40)]
    path.write_text("timestamp,voltage_V,force_N\n" + "\n".join(lines) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read_recording(path).time_s, 2.0 * np.arange(40), atol=1e-6)


@pytest.mark.parametrize("start", [46354.416667, 740314.416667])
def test_days_as_a_spreadsheet_counts_them_are_asked_about_and_read(tmp_path, start):
    path = tmp_path / "days.csv"
    lines = [f"{start + k / 86400:.9f};{k};{k}" for k in range(40)]
    path.write_text("Time;U [V];F [N]\n" + "\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="may be s, ms, days or a count"):
        read_recording(path)
    read = read_recording(path, TextOptions(columns=("time_d", "voltage_V", "force_N")))
    np.testing.assert_allclose(np.diff(read.time_s), 1.0, atol=1e-3)


def test_a_pause_of_an_hour_stays_where_stamps_have_their_zone(tmp_path):
    recording, notes = local_file(
        tmp_path,
        datetime.fromisoformat("2026-03-29 01:58"),
        change_after=239,
        hours=1,
        form="%Y-%m-%d %H:%M:%S.%f+01:00",
    )
    assert notes == []
    assert recording.time_s[-1] == pytest.approx(399 * STEP_S + 3600)
