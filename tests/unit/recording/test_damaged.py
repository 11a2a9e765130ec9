"""Damaged and malicious files: the error is one line with the path, memory is bounded, nothing is executed."""

import os
import pickle
import resource
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import open_stream, read_recording, write_recording
from piezod.recording.files import FORMATS
from tests.unit.recording.formats import sample, suffixes

many = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])

MOST_MB = 400


class Bomb:
    def __reduce__(self):
        return os._exit, (13,)


def read_or_refused(path):
    """Read a file; check that an error is one line that begins with the path, and that memory stays bounded."""
    before_kB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    message = f"{path}: undamaged"
    try:
        read_recording(path)
    except RecordingError as error:
        message = str(error)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kB < MOST_MB * 1000


def overwrite(path, mark, offset, new):
    """Replace bytes of a file, `offset` bytes after the first occurrence of `mark`."""
    content = bytearray(path.read_bytes())
    at = content.index(mark) + offset
    content[at : at + len(new)] = new
    path.write_bytes(content)


@pytest.mark.parametrize("suffix", suffixes())
@many
@given(content=st.binary(max_size=400), magic=st.booleans())
def test_random_bytes_are_refused(tmp_path, suffix, content, magic):
    path = tmp_path / f"rec{suffix}"
    begin = FORMATS[suffix].magic[0] if magic and FORMATS[suffix].magic else b""
    path.write_bytes(begin + content)
    read_or_refused(path)


@pytest.mark.parametrize("suffix", suffixes())
@many
@given(data=st.data())
def test_a_file_with_bytes_changed_is_read_or_refused(tmp_path, suffix, data):
    path = tmp_path / f"rec{suffix}"
    write_recording(sample(30), path)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        new = data.draw(st.sampled_from([b"\xff", b"\0", b"\x01", b"\xff" * 8, b"\0" * 8, bytes([content[at] ^ 16])]))
        content[at : at + len(new)] = new
    path.write_bytes(content)
    read_or_refused(path)


@pytest.mark.parametrize("suffix", suffixes())
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9, 0.99])
def test_a_file_cut_off_is_read_or_refused(tmp_path, suffix, share):
    path = tmp_path / f"rec{suffix}"
    write_recording(sample(200), path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    read_or_refused(path)


@given(
    text=st.text(st.sampled_from("0123456789+-.,eEnaif \t\r\n#"), max_size=120).map(lambda rows: "time_s,a_V\n" + rows)
)
@many
def test_any_text_after_a_header_is_read_or_refused(tmp_path, text):
    path = tmp_path / "rec.csv"
    path.write_text(text, encoding="utf-8", newline="")
    read_or_refused(path)


@pytest.mark.parametrize("suffix", suffixes(".h5", ".parquet", ".mat", ".tdms", ".mf4", ".sqlite"))
@pytest.mark.parametrize(
    ("time_s", "message"), [([0.0, 1.0, 1.0], "must strictly increase"), ([0.0, np.nan, 1.0], "is not finite")]
)
def test_time_that_does_not_increase_is_refused_in_every_format(tmp_path, suffix, time_s, message):
    path = tmp_path / f"rec{suffix}"
    recording = sample(3)
    recording.time_s[:] = time_s
    write_recording(recording, path)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(path)
    assert str(caught.value).startswith(str(path))


def test_mat_cells_structs_and_objects_are_left_out(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "rec.mat"
    cell = np.empty(1, dtype=object)
    cell[0] = "os.system('false')"
    savemat(path, {"time_s": [0.0, 1.0], "force_N": [1, 2], "c": cell, "s": {"f": 1}, "m": np.eye(3), "t": "text"})
    recording = read_recording(path)
    assert list(recording.channels) == ["force_N"]
    assert recording.metadata["skipped"] == "cell c, struct s, double m, char t"


def test_a_mat_file_with_only_a_struct_is_refused(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "rec.mat"
    savemat(path, {"s": {"time_s": [0.0, 1.0]}})
    with pytest.raises(RecordingError, match="has no time_s, has no columns of numbers"):
        read_recording(path)


def test_a_pickle_is_never_opened_whatever_its_suffix(tmp_path):
    for suffix in FORMATS:
        path = tmp_path / f"rec{suffix}"
        path.write_bytes(pickle.dumps(Bomb()))
        with pytest.raises(RecordingError):
            read_recording(path)


def test_hdf5_follows_no_link_to_another_file(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    secret, raw, path = tmp_path / "secret.h5", tmp_path / "secret.bin", tmp_path / "rec.h5"
    raw.write_bytes(np.arange(2.0).tobytes())
    with h5py.File(secret, "w") as file:
        file["key_V"] = np.arange(2.0)
    with h5py.File(path, "w") as file:
        file["time_s"] = file["force_N"] = np.arange(2.0)
        file["linked"] = h5py.ExternalLink(str(secret), "key_V")
        file["soft"] = h5py.SoftLink("/force_N")
        file.create_dataset("stored", (2,), float, external=[(str(raw), 0, 16)])
        layout = h5py.VirtualLayout((2,), float)
        layout[:] = h5py.VirtualSource(str(secret), "key_V", shape=(2,))
        file.create_virtual_dataset("virtual", layout)
        file["self"] = file["/"]
        file["reference"] = np.array([file["force_N"].ref] * 2, dtype=h5py.ref_dtype)
    recording = read_recording(path)
    assert set(recording.channels) == {"force_N"}
    for left_out in ("linked", "soft", "stored", "virtual", "reference"):
        assert left_out in recording.metadata["skipped"]


def test_hdf5_that_claims_more_than_its_size_is_refused_before_reading(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "rec.h5"
    with h5py.File(path, "w") as file:
        for name in ("time_s", "force_N"):
            file.create_dataset(name, (10**12,), float, chunks=(1024,))
    with pytest.raises(RecordingError, match=r"claims 2e\+12 numbers, a file of its size may hold"):
        next(open_stream(path))


def test_mat_that_claims_more_than_its_size_is_refused_before_reading(tmp_path):
    path = tmp_path / "rec.mat"
    write_recording(sample(5), path)
    content = path.read_bytes()
    path.write_bytes(content.replace(struct.pack("<2i", 5, 1), struct.pack("<2i", 2**31 - 1, 1)))
    with pytest.raises(RecordingError, match="claims"):
        read_recording(path)


def test_a_deflated_mat_file_that_grows_beyond_its_claim_is_refused(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "rec.mat"
    savemat(path, {"time_s": np.arange(3.0), "zeros": np.zeros(20_000_000, dtype=np.uint8)}, do_compression=True)
    assert len(zlib.compress(bytes(20_000_000))) < 20_000
    assert path.stat().st_size < 30_000
    with pytest.raises(RecordingError, match=r"zeros has 20000000 samples|claims 2e"):
        read_recording(path)


def test_mdf_whose_blocks_link_back_is_refused(tmp_path):
    pytest.importorskip("asammdf", reason="asammdf is not installed")
    path = tmp_path / "rec.mf4"
    write_recording(sample(5), path)
    history = path.read_bytes().index(b"##FH")
    overwrite(path, b"##FH", 24, struct.pack("<Q", history))
    with pytest.raises(RecordingError, match="linked to twice"):
        read_recording(path)


def test_hdf5_with_an_endless_heap_is_refused(tmp_path):
    pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "rec.h5"
    write_recording(sample(5), path)
    overwrite(path, b"GCOL", 16, bytes(16))
    with pytest.raises(RecordingError, match="is damaged: text at byte"):
        read_recording(path)


def test_hdf5_whose_heap_claims_gigabytes_is_refused(tmp_path):
    pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "rec.h5"
    write_recording(sample(5), path)
    overwrite(path, b"GCOL", 8, struct.pack("<Q", 2**32))
    with pytest.raises(RecordingError, match=r"is damaged: text at byte .* claims 4294967296 bytes"):
        read_recording(path)


@pytest.mark.parametrize("deflated", [False, True])
@pytest.mark.parametrize("kind", ["f4", "f8", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "b1"])
def test_mat_numbers_are_equal_to_those_of_scipy(tmp_path, kind, deflated):
    from scipy.io import loadmat, savemat

    path = tmp_path / "rec.mat"
    values = np.arange(7).astype(kind)
    savemat(path, {"time_s": np.arange(7.0), "x": values, "row": values[None, :]}, do_compression=deflated)
    for name, there in read_recording(path).channels.items():
        np.testing.assert_array_equal(there, loadmat(path)[name].ravel().astype(float))


def test_an_unfinished_mdf_is_refused(tmp_path):
    pytest.importorskip("asammdf", reason="asammdf is not installed")
    path = tmp_path / "rec.mf4"
    path.write_bytes(b"UnFinMF 4.10    ".ljust(200, b"\0"))
    with pytest.raises(RecordingError, match="finalise it"):
        read_recording(path)


def test_tdms_channels_of_different_length_are_refused(tmp_path):
    nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed")
    path = tmp_path / "rec.tdms"
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("a", n, np.arange(m)) for n, m in (("time_s", 5.0), ("force_N", 4.0))])
    with pytest.raises(RecordingError, match="force_N has 4 samples, time_s has 5; must be the same"):
        read_recording(path)


def test_a_tdms_name_that_claims_gigabytes_allocates_no_more_than_the_file_holds(tmp_path):
    pytest.importorskip("nptdms", reason="nptdms is not installed")
    path = tmp_path / "rec.tdms"
    write_recording(sample(5), path)
    overwrite(path, b"/'recording'/'voltage_V'", -4, struct.pack("<I", 2**32 - 1))
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError):
            read_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()
