"""Recordings in SQLite: read during writing, checked block by block; ticks become samples."""

import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import RecordingError
from piezod.recording import open_stream, read_recording, write_recording
from piezod.recording.formats.sqlite import read_end
from piezod.recording.formats.sqlite_blocks import Block, layout_of, pack, unpack
from piezod.recording.formats.sqlite_tables import About, append_block, create_tables
from piezod.recording.ring_log import ROW_DTYPE
from tests.benches.recorded_blocks import read_blocks
from tests.unit.recording.formats import sample


def ticks(count, first=0):
    rows = np.zeros(count, ROW_DTYPE)
    rows["tick"] = np.arange(first, first + count)
    rows["time_ns"] = 10**9 + 10**6 * rows["tick"]
    for name, offset in (("voltage_V", 0.0), ("force_N", 1000.0), ("reference_N", 2000.0), ("readback_V", 3000.0)):
        rows[name] = rows["tick"] + offset
    rows["temperature_C"] = np.nan
    return rows


def writer(path, **about):
    """Open connection to a file as the recorder writes it, with a write-ahead log."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("BEGIN")
    create_tables(connection, About(ROW_DTYPE, "ticks", {"bench": "b"}, origin_ns=10**9, **about))
    connection.execute("COMMIT")
    return connection


def commit(connection, rows, first=0):
    connection.execute("BEGIN")
    append_block(connection, Block(rows, first, 5 * 10**18, 10**9))
    connection.execute("COMMIT")


@given(st.binary(min_size=96, max_size=960), st.integers(0, 2**63), st.integers(-(2**62), 2**62))
def test_a_block_is_unchanged_after_packing_and_unpacking(content, first, wall_ns):
    rows = np.frombuffer(content[: len(content) // 96 * 96], ROW_DTYPE)
    again = unpack(*pack(Block(rows, first, wall_ns, -wall_ns)), ROW_DTYPE)
    assert again.rows.tobytes() == rows.tobytes()
    assert (again.first, again.wall_ns, again.clock_ns) == (first, wall_ns, -wall_ns)


@given(st.integers(0, 10**6), st.integers(0, 7))
def test_any_flipped_bit_makes_a_block_damaged(place, bit):
    checksum, data = pack(Block(ticks(20)))
    damaged = bytearray(data)
    damaged[place % len(data)] ^= 1 << bit
    assert unpack(checksum, bytes(damaged), ROW_DTYPE) is None


@pytest.mark.parametrize(
    "text", ["{}", "[]", '[["a"]]', '[["a", "O"]]', '[["a", "<f8"], ["a", "<f8"]]', '[[1, "<f8"]]']
)
def test_a_layout_of_anything_but_numbers_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        layout_of(text)


def test_a_sample_pairs_a_command_with_the_force_after_it(tmp_path):
    connection = writer(tmp_path / "a.sqlite")
    rows = ticks(6)
    rows["result"][4] = 1
    commit(connection, rows)
    recording = read_recording(tmp_path / "a.sqlite")
    connection.close()
    assert list(recording.channel("tick")) == [1, 2, 3, 4, 5]
    assert list(recording.channel("voltage_V")) == [0, 1, 2, 3, 4]
    assert list(recording.channel("reference_N")) == [2000, 2001, 2002, 2003, 2004]
    np.testing.assert_array_equal(recording.channel("force_N"), [1001, 1002, 1003, np.nan, 1005])
    np.testing.assert_allclose(recording.time_s, [0.001, 0.002, 0.003, 0.004, 0.005])
    np.testing.assert_allclose(recording.channel("wall_s") - 5e9, recording.time_s, atol=2e-6)


def test_missed_ticks_are_gaps_in_time_also_between_blocks(tmp_path):
    connection = writer(tmp_path / "a.sqlite")
    commit(connection, ticks(10))
    commit(connection, ticks(10, first=17), first=10)
    recording = read_recording(tmp_path / "a.sqlite")
    connection.close()
    assert recording.time_s.size == 19
    assert np.diff(recording.time_s).max() == pytest.approx(0.008)
    assert recording.channel("voltage_V")[9] == 9


def test_an_absent_measurement_is_no_column(tmp_path):
    connection = writer(tmp_path / "a.sqlite", absent=("temperature_C",))
    commit(connection, ticks(3))
    assert "temperature_C" not in read_recording(tmp_path / "a.sqlite").channels
    connection.close()


def test_a_file_is_read_during_writing_and_the_reader_does_not_block_the_writer(tmp_path):
    connection = writer(tmp_path / "a.sqlite")
    commit(connection, ticks(100))
    stream = open_stream(tmp_path / "a.sqlite", ["force_N"], chunk=10)
    assert next(stream).time_s.size == 10
    commit(connection, ticks(100, 100), 100)
    assert connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0
    assert sum(piece.time_s.size for piece in stream) == 89, "what was committed when it was opened"
    assert read_recording(tmp_path / "a.sqlite").time_s.size == 199
    connection.close()


def test_after_a_crash_the_committed_blocks_are_read_and_an_incomplete_one_is_not(tmp_path):
    connection = writer(tmp_path / "a.sqlite")
    for k in range(5):
        commit(connection, ticks(50, 50 * k), 50 * k)
    for suffix in ("", "-wal"):  # what the disk has at the moment of the crash
        (tmp_path / f"b.sqlite{suffix}").write_bytes((tmp_path / f"a.sqlite{suffix}").read_bytes())
    connection.close()
    log = tmp_path / "b.sqlite-wal"
    assert read_recording(tmp_path / "b.sqlite").time_s.size == 249
    os.truncate(log, log.stat().st_size - 700)
    assert read_recording(tmp_path / "b.sqlite").time_s.size == 199
    assert read_end(tmp_path / "b.sqlite")[1] == 200


def closed_file(path, blocks=40):
    connection = writer(path)
    for k in range(blocks):
        commit(connection, ticks(200, 200 * k), 200 * k)
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.close()


def test_a_damaged_block_is_left_out_and_counted(tmp_path):
    path = tmp_path / "a.sqlite"
    closed_file(path)
    with sqlite3.connect(path) as connection:
        data = bytearray(connection.execute("SELECT data FROM block WHERE id = 7").fetchone()[0])
        data[100] ^= 1
        connection.execute("UPDATE block SET data = ? WHERE id = 7", (bytes(data),))
        connection.execute("DELETE FROM block WHERE id = 20")
    connection.close()
    recording = read_recording(path)
    assert recording.metadata["damaged"] == "2 of 40 blocks, left out"
    assert recording.time_s.size == 38 * 200 - 1
    assert not set(range(1200, 1400)) & set(recording.channel("tick").astype(int))


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_page_does_not_affect_the_other_blocks(tmp_path, seed):
    path = tmp_path / "a.sqlite"
    closed_file(path)
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    page = int(rng.integers(4, len(content) // 4096 - 1))  # the first pages say what the file is
    content[page * 4096 : (page + 1) * 4096] = rng.bytes(4096)
    path.write_bytes(content)
    _, blocks, damaged = read_blocks(path)
    assert damaged >= 1
    assert len(blocks) + damaged == 40
    assert all((block.rows["tick"] == np.arange(block.first, block.first + 200)).all() for block in blocks)
    assert len(blocks) > 20


ENDLESS = """CREATE VIEW block AS
    WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 0 AS crc, x'' AS data FROM n"""


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE TABLE block (x)",
        ENDLESS,
        "CREATE TABLE other (x)",
    ],
)
def test_another_database_is_refused_and_its_view_is_not_executed(tmp_path, statement):
    path = tmp_path / "a.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
        connection.execute(statement)
    connection.close()
    with pytest.raises(RecordingError, match="its tables are not those of piezod"):
        read_recording(path)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("schema", "piezod.recording/2", "schema is 'piezod.recording/2', must be 'piezod.recording/1'"),
        ("layout", '[["force_N", "|O"]]', "its table 'about' is damaged"),
        ("metadata", "[" * 100_000, "its table 'about' is damaged"),
        ("origin_ns", "soon", "its table 'about' is damaged"),
    ],
)
def test_a_file_with_an_invalid_about_table_is_refused(tmp_path, key, value, says):
    path = tmp_path / "a.sqlite"
    write_recording(sample(5), path)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE about SET value = ? WHERE key = ?", (value, key))
    connection.close()
    with pytest.raises(RecordingError, match=says.replace("(", r"\(")):
        read_recording(path)


def test_a_block_that_claims_gigabytes_is_left_out(tmp_path):
    import struct
    import zlib

    path = tmp_path / "a.sqlite"
    write_recording(sample(5), path)
    data = struct.pack("<IQqq", 2**26, 5, 0, 0) + zlib.compress(bytes(2**24), 9)
    with sqlite3.connect(path) as connection:
        connection.execute("INSERT INTO block (crc, data) VALUES (?, ?)", (zlib.crc32(data), data))
    connection.close()
    recording = read_recording(path)
    assert recording.time_s.size == 5
    assert recording.metadata["damaged"] == "1 of 2 blocks, left out"


READ = """
import os, sys
from pathlib import Path
from piezod.recording import read_recording
os.setgid(65534)
os.setuid(65534)
print(read_recording(Path(sys.argv[1])).time_s.size)
"""


@pytest.fixture
def open_folder():
    """Folder that every user may read; the folders of pytest are for one user only."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.mark.skipif(os.getuid() != 0, reason="needs root rights to change the user")
@pytest.mark.parametrize("state", ["written", "crashed", "closed", "checkpointed, then crashed"])
def test_a_user_with_read_access_only_reads_the_file_in_every_state(open_folder, state):
    path = open_folder / "a.sqlite"
    connection = writer(path)
    commit(connection, ticks(100))
    if state == "closed":
        connection.execute("PRAGMA journal_mode = DELETE")
    if state == "checkpointed, then crashed":
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    if "crashed" in state:
        path = open_folder / "b.sqlite"
        suffixes = ("", "-wal", "-shm") if state == "crashed" else ("",)
        for suffix in suffixes:
            (open_folder / f"b.sqlite{suffix}").write_bytes((open_folder / f"a.sqlite{suffix}").read_bytes())
    for file in open_folder.iterdir():
        file.chmod(0o644)
    command = [sys.executable, "-c", READ, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    connection.close()
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 99


def test_damaged_blocks_are_a_note_of_the_identification(tmp_path):
    from piezod.estimation.recordings.intake import load_for_simulation

    path = tmp_path / "a.sqlite"
    closed_file(path)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE block SET crc = crc + 1 WHERE id IN (3, 4)")
    connection.close()
    loaded = load_for_simulation(path, "voltage_V", "force_N")
    assert f"{path}: damaged: 2 of 40 blocks, left out" in loaded.notes
