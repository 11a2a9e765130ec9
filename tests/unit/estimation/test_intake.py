"""What is taken in of a recording file: the columns wanted, of any format; holes bridged or cut; rails left out."""

import hashlib

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from piezod.errors import RecordingError, UsageError
from piezod.estimation.recordings.intake import load_for_simulation, load_recordings
from piezod.estimation.recordings.suitability import check_suitable
from piezod.excitation import constant_triangles, staircase_minor_loops_multisine
from piezod.operators import PrandtlIshlinskii
from piezod.recording import Recording, write_recording
from tests.unit.recording.formats import suffixes

RATE_HZ = 100.0
U = constant_triangles(140.0, 0.1, 4, RATE_HZ)


def force(u, noise_N=0.3):
    operator = PrandtlIshlinskii([0.0, 5.0, 20.0, 50.0], [1.0, 0.1, 0.1, 0.2], [0.0], [2.0])
    return operator.run(u) + np.random.default_rng(2).normal(0.0, noise_N, u.size)


def recorded(u=U, time_s=None, **channels):
    time_s = np.arange(u.size) / RATE_HZ if time_s is None else time_s
    return Recording(time_s, {"voltage_V": u, "force_N": force(u)} | channels)


def written(folder, recording, name="rec.csv"):
    write_recording(recording, folder / name)
    return folder / name


def taken(folder, recording):
    return load_recordings([written(folder, recording)], "voltage_V", "force_N")[0]


@pytest.mark.parametrize("suffix", suffixes())
def test_the_wanted_columns_and_the_temperature_come_from_every_format_with_the_hash_of_the_file(tmp_path, suffix):
    original = recorded(temperature_degC=np.full(U.size, 23.0), current_A=np.full(U.size, 0.1))
    path = written(tmp_path, original, f"rec{suffix}")
    (one,) = load_recordings([path], "voltage_V", "force_N")
    assert list(one.recording.channels) == ["voltage_V", "force_N", "temperature_C"]
    np.testing.assert_allclose(one.recording.time_s, original.time_s, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.recording.channel("force_N"), original.channel("force_N"), rtol=1e-8)
    np.testing.assert_array_equal(one.recording.channel("temperature_C"), 23.0)
    assert one.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert one.notes == []
    assert one.source.samples == U.size


@pytest.mark.parametrize(("unit", "factor"), [("kV", 1e-3), ("mV", 1e3)])
def test_a_column_in_another_multiple_of_its_unit_is_converted_and_that_is_said(tmp_path, unit, factor):
    one = taken(tmp_path, Recording(recorded().time_s, {f"voltage_{unit}": factor * U, "force_kN": force(U) / 1e3}))
    np.testing.assert_allclose(one.recording.channel("voltage_V"), U, atol=1e-6)
    np.testing.assert_allclose(one.recording.channel("force_N"), force(U), rtol=1e-7)
    assert any(f"voltage_V: is voltage_{unit} times {1 / factor:g}" in note for note in one.notes)


def test_a_column_that_is_not_there_is_named_with_those_that_are(tmp_path):
    path = written(tmp_path, recorded())
    with pytest.raises(RecordingError, match="has no column displacement_um, has voltage_V, force_N"):
        load_recordings([path], "voltage_V", "displacement_um")
    with pytest.raises(UsageError, match="are both voltage_V"):
        load_recordings([path], "voltage_V", "voltage_V")


def test_inputs_missing_for_a_few_samples_are_interpolated(tmp_path):
    u = U.copy()
    u[[50, 51, 52, 300]] = np.nan
    one = taken(tmp_path, recorded(voltage_V=u))
    np.testing.assert_allclose(one.recording.channel("voltage_V"), U, atol=1e-6)
    (note,) = one.notes
    assert note.endswith("voltage_V: 4 samples missing (0.1 %), the first at 0.5 s; 4 of them interpolated")


def test_a_force_sampled_less_often_than_the_voltage_and_between_its_samples_is_kept_where_it_is(tmp_path):
    """One file of two clocks: each row holds one of the two."""
    u, y = np.full(U.size, np.nan), np.full(U.size, np.nan)
    u[::2], y[1::4] = U[::2], force(U)[1::4]
    one = taken(tmp_path, recorded(voltage_V=u, force_N=y))
    kept = slice(0, one.recording.time_s.size)
    np.testing.assert_allclose(one.recording.channel("voltage_V"), U[kept], atol=1e-6)
    np.testing.assert_allclose(one.recording.channel("force_N"), y[kept], rtol=1e-8)


@pytest.mark.parametrize("rows", ["absent", "empty"])
def test_where_the_input_is_missing_for_long_the_longest_stretch_is_kept(tmp_path, rows):
    whole = recorded()
    gap = slice(1000, 1400)
    if rows == "absent":
        there = np.r_[0 : gap.start, gap.stop : U.size]
        bad = Recording(whole.time_s[there], {k: v[there] for k, v in whole.channels.items()})
    else:
        bad = whole
        bad.channels["voltage_V"] = U.copy()
        bad.channels["voltage_V"][gap] = np.nan
    one = taken(tmp_path, bad)
    np.testing.assert_allclose(one.recording.time_s, np.arange(gap.stop, U.size) / RATE_HZ, atol=1e-9)
    np.testing.assert_allclose(one.recording.channel("voltage_V"), U[gap.stop :], atol=1e-6)
    assert any("only 14 to 40 s, 2601 of" in note and "; no input from 9.99 to 14 s" in note for note in one.notes), (
        one.notes
    )


def test_a_pause_in_which_the_input_could_not_move_is_bridged(tmp_path):
    u = constant_triangles(140.0, 0.01, 1, RATE_HZ)
    there = np.r_[0:3000, 3007 : u.size]  # 70 ms of 50 s
    whole = recorded(u)
    one = taken(tmp_path, Recording(whole.time_s[there], {k: v[there] for k, v in whole.channels.items()}))
    assert one.recording.time_s.size == there.size
    (note,) = one.notes
    assert "time_s: irregular, periods of 0.01 to 0.08 s" in note


def test_jitter_is_said_and_no_sample_is_changed_by_it(tmp_path):
    time_s = np.arange(U.size) / RATE_HZ + np.random.default_rng(1).uniform(0, 2e-3, U.size)
    original = recorded(time_s=time_s)
    one = taken(tmp_path, original)
    np.testing.assert_allclose(one.recording.channel("force_N"), original.channel("force_N"), rtol=1e-8)
    (note,) = one.notes
    assert "time_s: irregular" in note
    assert "used as they are" in note


def test_missing_infinite_clipped_and_frozen_outputs_are_not_fitted_and_each_is_noted(tmp_path):
    y = force(U)
    y = np.minimum(y, 300.0)
    clipped = y == 300.0
    y[100:110], y[200] = np.nan, np.inf
    y[2300:2400] = y[2300]
    one = taken(tmp_path, recorded(force_N=y))
    expected = clipped.copy()
    expected[np.r_[100:110, 200, 2300:2400]] = True
    assert np.count_nonzero(np.isnan(one.recording.channel("force_N")) != expected) <= 8  # a lone 300 at a rail's edge
    assert [note.removeprefix(f"{tmp_path}/rec.csv: force_N: ")[:15] for note in one.notes] == [
        "1 sample, stray",
        "11 samples miss",
        "clipped at its ",
        "constant while ",
    ]
    assert one.notes[0].endswith("; left out")
    assert all(note.endswith("; not fitted") and "\n" not in note for note in one.notes[1:])


@pytest.mark.parametrize("levels", [2**16, 2**10, 2**8])
def test_of_a_quantised_reading_of_staircase_and_dwells_nothing_is_left_out(tmp_path, levels):
    u = staircase_minor_loops_multisine(140.0, 0.1, 1, RATE_HZ)
    y = np.round(force(u, 0.0) * levels / 320.0) * 320.0 / levels
    one = taken(tmp_path, recorded(u, force_N=y))
    assert one.notes == []
    assert np.isfinite(one.recording.channel("force_N")).all()


def test_a_force_that_is_clipped_for_more_than_half_its_samples_is_refused(tmp_path):
    with pytest.raises(
        RecordingError, match=r"clipped at its largest value 100, in .*s; 77 % of .* may be 50 %; give the"
    ):
        taken(tmp_path, recorded(force_N=np.minimum(force(U), 100.0)))


def test_an_input_that_is_there_only_in_snatches_is_refused(tmp_path):
    u = np.where(np.arange(U.size) % 100 < 60, U, np.nan)
    with pytest.raises(
        RecordingError, match=r"is there for 60 samples at a stretch, must be for 100; no input from 0\.59"
    ):
        taken(tmp_path, recorded(voltage_V=u))


def test_a_recording_to_simulate_keeps_every_row_and_may_have_no_output(tmp_path):
    there = np.r_[0:1000, 1400 : U.size]
    whole = recorded()
    path = written(tmp_path, Recording(whole.time_s[there], {"voltage_V": U[there], "on": there % 2.0}))
    one = load_for_simulation(path, "voltage_V", "force_N", ["on"])
    assert one.recording.time_s.size == there.size
    assert list(one.recording.channels) == ["voltage_V", "on"]
    assert any("no input from 9.99 to 14 s: what the input did there is not known" in note for note in one.notes)


def test_a_recording_to_simulate_must_have_its_input_in_every_row(tmp_path):
    u = U.copy()
    u[1000:1400] = np.nan
    path = written(tmp_path, recorded(voltage_V=u))
    with pytest.raises(
        RecordingError, match=r"voltage_V: 400 samples missing .* first at 10 s; must be there in every"
    ):
        load_for_simulation(path, "voltage_V", "force_N")


def test_an_empty_output_is_not_compared(tmp_path):
    path = written(tmp_path, recorded(force_N=np.full(U.size, np.nan)))
    one = load_for_simulation(path, "voltage_V", "force_N")
    assert "force_N" not in one.recording.channels
    assert one.notes == [f"{path}: force_N holds no number, nothing is compared"]


def test_reading_tells_how_far_it_is(tmp_path):
    said = []
    load_recordings(
        [written(tmp_path, recorded())], "voltage_V", "force_N", lambda what, share: said.append((what, share))
    )
    assert said == [("reading rec.csv, 0.0 million samples", None)]


CELLS = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 140.0, np.nan, np.inf, -np.inf, 1e-300, 1e300, -1.7e308]), st.floats(-1e3, 1e3)
)
CHANGES = st.lists(st.tuples(st.integers(0, 399), st.integers(1, 150), CELLS), max_size=4)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(100, np.full(400, 0.1), [(0, 2, np.inf)], [(10, 1, 0.0)])
@given(st.integers(1, 400), arrays(float, 400, elements=st.floats(1e-6, 1e3), fill=st.just(0.1)), CHANGES, CHANGES)
def test_whatever_a_file_holds_is_taken_in_and_judged_or_refused_in_one_line(tmp_path, n, periods, in_u, in_y):
    u = constant_triangles(140.0, 0.1, 4, 10.0)[:n].copy()
    y = force(u)
    for values, changes in ((u, in_u), (y, in_y)):
        for start, length, value in changes:
            values[start : start + length] = value
    path = written(tmp_path, Recording(np.cumsum(periods[: u.size]), {"voltage_V": u, "force_N": y}), "rec.h5")
    try:
        (one,) = load_recordings([path], "voltage_V", "force_N")
        assert np.isfinite(one.recording.channel("voltage_V")).all()
        said = one.notes + check_suitable(one.recording, "voltage_V", "force_N")
    except RecordingError as error:
        said = [str(error)]
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in said)
