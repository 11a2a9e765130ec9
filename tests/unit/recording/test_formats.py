"""Every file format: written and read, completely and in chunks; missing files and packages give a clear message."""

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from piezod.errors import ConfigurationError, RecordingError, UsageError
from piezod.recording import Recording, column_names, open_stream, read_recording, write_recording
from piezod.recording.files import FORMATS, check_output_path, check_recording_target, convert
from tests.unit.recording.formats import PACKAGES, REAL, recordings, same, sample, suffixes

quick = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


def test_every_suffix_is_tested():
    assert set(FORMATS) == set(PACKAGES)


@pytest.mark.parametrize("suffix", suffixes(".h5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite"))
@quick
@given(recording=recordings())
def test_a_binary_format_keeps_every_bit(tmp_path, suffix, recording):
    path = tmp_path / f"rec{suffix}"
    write_recording(recording, path)
    again = read_recording(path)
    same(recording, again)
    assert again.metadata == recording.metadata


@quick
@given(recording=recordings())
def test_csv_keeps_nine_digits(tmp_path, recording):
    path = tmp_path / "rec.csv"
    write_recording(recording, path)
    again = read_recording(path)
    np.testing.assert_allclose(again.time_s, recording.time_s, atol=5e-10, rtol=1e-15)
    for name, values in recording.channels.items():
        np.testing.assert_allclose(again.channels[name], values, rtol=5e-9)
    assert again.metadata == recording.metadata


@pytest.mark.parametrize("suffix", suffixes())
def test_a_stream_yields_the_samples_of_the_file_in_chunks(tmp_path, suffix):
    path = tmp_path / f"rec{suffix}"
    write_recording(sample(1000), path)
    whole = read_recording(path)
    pieces = list(open_stream(path, ["force_N"], chunk=96))
    assert max(piece.time_s.size for piece in pieces) <= 96
    assert all(list(piece.channels) == ["force_N"] for piece in pieces)
    np.testing.assert_array_equal(np.concatenate([piece.time_s for piece in pieces]), whole.time_s)
    np.testing.assert_array_equal(
        np.concatenate([piece.channel("force_N") for piece in pieces]), whole.channel("force_N")
    )


@pytest.mark.parametrize("suffix", suffixes())
def test_a_stream_of_a_missing_column_names_the_present_ones(tmp_path, suffix):
    path = tmp_path / f"rec{suffix}"
    write_recording(sample(5), path)
    with pytest.raises(RecordingError, match=r"has no column force_kN, has .*force_N"):
        next(open_stream(path, ["force_kN"]))


def test_a_stream_refuses_time_that_decreases_between_chunks(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("time_s,force_N\n0,1\n1,2\n0.5,3\n2,4\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="must strictly increase"):
        list(open_stream(path, chunk=2))


@pytest.mark.parametrize("chunk", [1, 2, 3, 100])
def test_a_stream_counts_samples_from_the_beginning_of_the_file(tmp_path, chunk):
    path = tmp_path / "rec.csv"
    path.write_text("time_s,force_N\n" + "".join(f"{time},1\n" for time in (0, 1, 2, 3, 3, 5)), encoding="utf-8")
    with pytest.raises(RecordingError, match="sample 4 is at 3 s after 3 s; write time with more digits"):
        list(open_stream(path, chunk=chunk))


@pytest.mark.parametrize("suffix", suffixes())
def test_column_names_are_the_names_that_reading_gives(tmp_path, suffix):
    write_recording(sample(), tmp_path / f"rec{suffix}")
    assert set(column_names(tmp_path / f"rec{suffix}")) == {"time_s", *sample().channels}


def test_a_recording_target_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    check_recording_target(tmp_path / "rec.csv")
    with pytest.raises(RecordingError, match=r"suffix is '\.txt', must be one of \.csv"):
        check_recording_target(tmp_path / "rec.txt")
    with pytest.raises(RecordingError, match=r"no/rec\.csv: cannot be written: .*no must be a folder"):
        check_recording_target(tmp_path / "no" / "rec.csv")
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(RecordingError, match=r"needs nptdms; pip install 'piezod-bench\[tdms\]'"):
        check_recording_target(tmp_path / "rec.tdms")


def test_an_output_path_that_is_a_recording_or_lies_in_no_folder_is_refused(tmp_path):
    path = tmp_path / "rec.csv"
    write_recording(sample(5), path)
    (tmp_path / "link.csv").symlink_to(path)
    for target in (path, tmp_path / "link.csv"):
        for check in (check_output_path, check_recording_target):
            with pytest.raises(UsageError, match="is a recording that is read"):
                check(target, [path])
    with pytest.raises(ConfigurationError, match="no is no folder"):
        check_output_path(tmp_path / "no" / "model.yaml", [path])
    check_output_path(tmp_path / "model.yaml", [path])


@pytest.mark.parametrize("suffix", suffixes())
def test_an_existing_file_is_unchanged_after_an_error_in_writing(tmp_path, suffix):
    path = tmp_path / f"rec{suffix}"
    path.write_bytes(b"precious")
    broken = Recording(np.arange(3.0), {"force_N": np.zeros(3)})
    broken.channels["force_N"] = np.array(["a", "b", "c"])
    with pytest.raises(RecordingError, match=r"rec.*cannot be written"):
        write_recording(broken, path)
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", suffixes(".h5", ".tdms", ".parquet", ".mf4"))
def test_a_missing_package_is_named_with_the_extra_to_install(tmp_path, suffix, monkeypatch):
    monkeypatch.setitem(sys.modules, PACKAGES[suffix], None)
    extra = {".h5": "hdf5", ".mf4": "mdf"}.get(suffix, suffix[1:])
    with pytest.raises(RecordingError, match=rf"needs {PACKAGES[suffix]}; pip install 'piezod-bench\[{extra}\]'"):
        write_recording(sample(3), tmp_path / f"rec{suffix}")


@pytest.mark.parametrize("suffix", suffixes(".h5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite"))
def test_a_suffix_of_another_format_is_refused_with_the_format_of_the_content(tmp_path, suffix):
    path = tmp_path / f"rec{suffix}"
    write_recording(sample(3), path)
    wrong = path.rename(tmp_path / "rec.csv")
    with pytest.raises(RecordingError, match=rf"holds {FORMATS[suffix].name}, its suffix says CSV"):
        read_recording(wrong)


@pytest.mark.parametrize("name", ["rec.docx", "rec", "rec.npy", "rec.pkl"])
def test_an_unknown_suffix_is_refused_before_anything_is_read(tmp_path, name):
    with pytest.raises(RecordingError, match=r"must be one of \.csv"):
        convert(tmp_path / "absent.csv", tmp_path / name)


@pytest.mark.parametrize("suffix", suffixes())
def test_a_missing_file_is_one_line(tmp_path, suffix):
    path = tmp_path / f"absent{suffix}"
    with pytest.raises(RecordingError, match="cannot be read: No such file") as caught:
        read_recording(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is absent")
@pytest.mark.parametrize("suffix", suffixes(".h5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite"))
def test_a_measured_recording_is_the_same_in_every_format(tmp_path, suffix):
    source = REAL / "pneumatic-friction" / "circle_5bar.csv"
    convert(source, tmp_path / f"rec{suffix}")
    same(read_recording(source), read_recording(tmp_path / f"rec{suffix}"))
