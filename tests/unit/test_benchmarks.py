"""The table of the benchmarks holds what it promises; how fast anything is, it does not assert."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """What is printed, and the rows as written by --json, of the cheap benchmarks."""
    file = tmp_path_factory.mktemp("benchmarks") / "rows.json"
    command = [sys.executable, "-m", "tests.benchmarks", "chain", "batch", "--quick", "--json", str(file)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    return done.stdout, json.loads(file.read_text(encoding="utf-8"))


@pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="the limits are measured in C: no compiler")
def test_every_figure_of_chain_and_batch_stands_beside_its_limit_and_their_ratio(table):
    _, rows = table
    assert {row["benchmark"] for row in rows} == {"chain", "batch"}
    for row in rows:
        assert row["figure"] > 0
        assert row["limit"] > 0
        assert row["ratio"] == pytest.approx(row["figure"] / row["limit"])


def test_every_row_is_printed(table):
    text, rows = table
    assert all(row["what"] in text for row in rows)


def test_the_compiled_batch_gives_what_the_same_in_c_gives(table):
    _, rows = table
    batch = [row for row in rows if row["benchmark"] == "batch" and row["limit"]]
    assert all(row["note"] == "largest difference of the outputs 0" for row in batch)


def test_an_unknown_benchmark_is_refused_by_name():
    command = [sys.executable, "-m", "tests.benchmarks", "speed"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "no benchmark is called speed" in done.stderr
