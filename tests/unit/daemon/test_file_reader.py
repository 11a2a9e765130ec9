"""Reading the files of a bench in a child process."""

import asyncio
import multiprocessing
import os
import shutil
import time

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config.regular_file import open_regular
from piezod.daemon.file_reader import _read, load_bench_files, read_bench_files
from piezod.errors import ConfigurationError, TemporaryError


@pytest.fixture
def bench(tmp_path):
    for name in ("bench.yaml", "model.yaml"):
        shutil.copy(shipped("bench.yaml").with_name(name), tmp_path / name)
    return tmp_path / "bench.yaml"


def test_the_child_process_reads_the_same_as_this_one(bench):
    assert asyncio.run(read_bench_files(bench)) == load_bench_files(bench)


def test_an_error_of_the_child_process_is_raised_here(bench):
    bench.write_text("name: 3\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=str(bench)):
        asyncio.run(read_bench_files(bench))


@pytest.mark.parametrize("which", ["bench", "model"])
def test_a_pipe_in_place_of_a_file_is_refused_unread(bench, which):
    pipe = bench if which == "bench" else bench.with_name("model.yaml")
    pipe.unlink()
    os.mkfifo(pipe)
    with pytest.raises(ConfigurationError, match="must be a regular file"):
        asyncio.run(read_bench_files(bench))


def test_reading_that_takes_too_long_is_ended(bench):
    begun_s = time.monotonic()
    with pytest.raises(TemporaryError, match="not read within"):
        asyncio.run(read_bench_files(bench, 1e-3))
    assert time.monotonic() - begun_s < 10.0


@pytest.mark.parametrize(("size", "accepted"), [(10, True), (11, False)])
def test_a_file_above_the_largest_size_is_refused(tmp_path, size, accepted):
    path = tmp_path / "file"
    path.write_bytes(bytes(size))
    if accepted:
        with open_regular(path, 10) as file:
            assert file.read() == bytes(size)
    else:
        with pytest.raises(ConfigurationError, match="has 11 bytes, must have at most 10"):
            open_regular(path, 10)


def test_a_reader_whose_daemon_has_ended_ends_without_an_error(bench):
    ours, theirs = multiprocessing.Pipe(duplex=False)
    ours.close()
    _read(bench, theirs)
    with pytest.raises(BrokenPipeError):
        theirs.send("the other end is closed")
