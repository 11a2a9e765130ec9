"""Rounded and repeated time stamps."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import open_stream, read_recording
from piezod.recording.time_stamps import TimeStamps


def write(path, time_s, values=None, header="time_s,voltage_V,force_N"):
    values = np.arange(time_s.size) if values is None else values
    rows = [f"{t:.9g},{v:.9g},{2 * v:.9g}" for t, v in zip(time_s, values, strict=True)]
    path.write_text(header + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("header", ["time_s,voltage_V,force_N", "Time [s],Voltage [V],Force [N]"])
@pytest.mark.parametrize("rounding", [np.round, lambda t, n: np.floor(t * 10**n) / 10**n])
@pytest.mark.parametrize("chunk", [50, 977, 65536])
def test_rounded_stamps_of_even_samples_are_spread_within_two_resolutions(tmp_path, header, rounding, chunk):
    true_s = 3.0 + np.arange(4000) / 3000.0
    path = write(tmp_path / "rec.csv", rounding(true_s, 2), header=header)
    pieces = list(open_stream(path, chunk=chunk))
    found_s = np.concatenate([piece.time_s for piece in pieces])
    assert found_s.size == true_s.size
    assert (np.diff(found_s) > 0.0).all()
    assert np.abs(found_s - true_s).max() < 0.02
    assert "rounded to 0.01 s" in pieces[-1].metadata["time"]


@given(
    samples=st.integers(16, 400),
    rate_Hz=st.floats(300.0, 3000.0),
    cuts=st.lists(st.integers(1, 399), max_size=6),
    floor=st.booleans(),
)
def test_rounded_stamps_rise_strictly_however_the_file_is_cut_into_blocks(samples, rate_Hz, cuts, floor):
    true_s = np.arange(samples) / rate_Hz
    stamps_s = np.floor(true_s * 100.0) / 100.0 if floor else np.round(true_s, 2)
    first = next((k for k in sorted(set(cuts)) if 16 <= k < samples and len(set(stamps_s[:k])) > 1), samples)
    edges = [0, first, *sorted(k for k in set(cuts) if first < k < samples), samples]
    blocks = [{"time_s": stamps_s[a:b]} for a, b in itertools.pairwise(edges) if b > a]
    found_s = np.concatenate([block["time_s"] for block in TimeStamps().cleaned(iter(blocks), "time_s")])
    if len(set(stamps_s[:first])) > 1:
        assert (np.diff(found_s) > 0.0).all()
        assert np.abs(found_s - true_s).max() < 0.03


@pytest.mark.parametrize("last", [1, 2, 5, 300])
def test_rows_written_twice_are_left_out_in_a_short_last_block_too(last):
    stamps_s = np.insert(np.arange(500) / 1000.0, [100, 500 - 1], [0.099, 0.498])
    blocks = [{"time_s": part, "force_N": part} for part in (stamps_s[:-last], stamps_s[-last:])]
    cleaned = TimeStamps().cleaned(iter(blocks), "time_s")
    assert np.concatenate([block["force_N"] for block in cleaned]) == pytest.approx(np.arange(500) / 1000.0)


def test_evenly_spaced_samples_stay_evenly_spaced(tmp_path):
    true_s = np.arange(5000) / 2000.0
    recording = read_recording(write(tmp_path / "rec.csv", np.round(true_s, 2)))
    assert recording.uniform
    assert recording.dt_s == pytest.approx(1 / 2000.0, rel=1e-3)


def test_rounded_stamps_with_a_pause_keep_the_pause(tmp_path):
    true_s = np.concatenate([np.arange(1000) / 1000.0, 5.0 + np.arange(1000) / 1000.0])
    recording = read_recording(write(tmp_path / "rec.csv", np.round(true_s, 2)))
    assert np.abs(recording.time_s - true_s).max() < 0.02
    assert (np.diff(recording.time_s) > 0.0).all()


def test_a_row_that_was_written_twice_is_left_out_and_told(tmp_path):
    time_s = np.insert(np.arange(1000) / 1000.0, 501, 0.5)
    recording = read_recording(write(tmp_path / "rec.csv", time_s))
    assert recording.time_s.size == 1000
    assert "samples with the time of the sample before, left out: 1" in recording.metadata["time"]


@pytest.mark.parametrize("time_s", [np.tile(np.arange(500) / 1000.0, 2), np.zeros(200), np.array([0.0, 1.0, 1.0])])
def test_time_that_falls_or_stands_is_refused_with_the_option(tmp_path, time_s):
    with pytest.raises(RecordingError, match="--rate-Hz"):
        read_recording(write(tmp_path / "rec.csv", time_s))
