"""A unit that a file stores beside the name is appended to it; time may come from the format itself."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import open_stream, read_recording
from piezod.recording.names import channel_name, unit_of


@pytest.mark.parametrize(
    ("name", "unit", "expected"),
    [
        ("Force", "kN", "Force_kN"),
        ("force_N", "N", "force_N"),
        ("Load cell 1", "N", "Load_cell_1_N"),
        ("Force [N]", "", "Force_N"),
        ("Temp (°C)", "", "Temp_C"),
        ("acceleration", "m/s²", "acceleration_m_per_s2"),
        ("travel", "µm", "travel_um"),
        ("travel", "\u03bcm", "travel_um"),
        ("temperature_degC", "degC", "temperature_degC"),
        ("temperature", "degC", "temperature_C"),
        ("share", "%", "share_percent"),
        ("state", "-", "state"),
        ("Time", "s", "time_s"),
        ("Time (s)", "", "time_s"),
    ],
)
def test_a_name_ends_in_its_unit(name, unit, expected):
    assert channel_name(name, unit) == expected


@pytest.mark.parametrize(("name", "unit"), [("force_N", "N"), ("slew_V_per_s", "V_per_s"), ("force", ""), ("_N", "")])
def test_the_unit_is_the_end_of_the_name(name, unit):
    assert unit_of(name) == unit
    assert channel_name(name, unit) == name


def test_tdms_joins_unit_strings_and_takes_time_from_the_waveform(tmp_path):
    nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed")
    path = tmp_path / "rec.tdms"
    wave = {"wf_increment": 0.01, "wf_start_offset": 2.0, "unit_string": "kN"}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                nptdms.ChannelObject("a", "Load cell", np.arange(5.0), wave),
                nptdms.ChannelObject("a", "count", np.arange(5, dtype=np.int16), wave | {"unit_string": ""}),
                nptdms.ChannelObject("a", "note", ["x"] * 5),
            ]
        )
    recording = read_recording(path)
    np.testing.assert_allclose(recording.time_s, 2.0 + 0.01 * np.arange(5))
    assert list(recording.channels) == ["Load_cell_kN", "count"]
    assert "note" in recording.metadata["skipped"]
    assert [piece.time_s[0] for piece in open_stream(path, chunk=2)] == pytest.approx([2.0, 2.02, 2.04])


def test_mdf_joins_units_and_takes_time_from_the_master(tmp_path):
    asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed")
    path = tmp_path / "rec.mf4"
    time_s = np.arange(6) * 0.5
    half = {"a": 0.5, "b": 1.0}  # physical = 0.5 raw + 1
    linear = asammdf.blocks.conversion_utils.from_dict(half)
    formula = asammdf.blocks.conversion_utils.from_dict({"formula": "X1 * 2"})
    with asammdf.MDF(version="4.10") as file:
        signals = [
            asammdf.Signal(np.arange(6, dtype=np.int16), time_s, name="Load cell", unit="kN", conversion=linear),
            asammdf.Signal(np.arange(6.0), time_s, name="computed", unit="V", conversion=formula),
            asammdf.Signal(
                np.arange(6.0),
                time_s,
                name="holes",
                unit="V",
                invalidation_bits=np.array([0, 1, 0, 0, 0, 0], dtype=bool),
            ),
        ]
        file.append(signals, common_timebase=True)
        file.save(path, overwrite=True)
    recording = read_recording(path)
    np.testing.assert_allclose(recording.time_s, time_s)
    np.testing.assert_allclose(recording.channel("Load_cell_kN"), 0.5 * np.arange(6) + 1)
    assert np.flatnonzero(recording.missing("holes_V")).tolist() == [1]
    assert list(recording.channels) == ["Load_cell_kN", "holes_V"]
    assert recording.metadata["skipped"] == "computed"


def test_hdf5_joins_unit_attributes_in_groups_too(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "rec.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("run 1")
        for name, unit in (("time", "s"), ("force", "N"), ("raw", "")):
            group[name] = np.arange(4, dtype=np.float32).reshape(4, 1)
            group[name].attrs["units"] = unit
    recording = read_recording(path)
    assert list(recording.channels) == ["force_N", "raw"]


def test_parquet_joins_unit_metadata_and_reads_nulls_as_missing(tmp_path):
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "rec.parquet"
    force = arrow.field("force", arrow.int32(), metadata={"unit": "N"})
    schema = arrow.schema([arrow.field("time_s", arrow.float32()), force, arrow.field("note", arrow.string())])
    parquet.write_table(arrow.table({"time_s": [0, 1, 2], "force": [1, None, 3], "note": ["", "", ""]}, schema), path)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.channel("force_N"), [1, np.nan, 3])
    assert recording.metadata == {"skipped": "note"}


def test_matlab_7_3_is_read_with_its_metadata_and_without_its_cells(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "rec.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, kind, values in (
            ("time_s", "double", np.arange(4.0).reshape(1, 4)),
            ("force_N", "single", np.arange(4, dtype=np.float32).reshape(1, 4)),
            ("title", "char", np.array([[120, 121, 122, 123]], dtype=np.uint16)),
            ("metadata", "char", np.array([list(b"bench: a b")], dtype=np.uint16).T),
        ):
            file[name] = values
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
        file.create_group("#refs#")["a"] = np.arange(7.0)
        file["cell"] = np.array([[file["#refs#/a"].ref]], dtype=h5py.ref_dtype)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    recording = read_recording(path)
    assert list(recording.channels) == ["force_N"]
    assert recording.metadata["bench"] == "a b"
    assert "cell" in recording.metadata["skipped"]
    assert [piece.time_s.size for piece in open_stream(path, chunk=3)] == [3, 1]


def test_two_columns_with_the_same_channel_name_are_refused(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("time_s,Force [N],Force_N\n0,1,2\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="has Force_N twice"):
        read_recording(path)
