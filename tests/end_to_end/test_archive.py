"""An archive of recordings as `piezod history` diagnoses it: new ones only, with one line for a damaged one."""

import json

import pytest

from tests.benches.emulator import piezod
from tests.studies.archive import fleet


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive") / "benches"
    fleet(folder, benches=1, recordings=2, seconds=20.0, seed=3)
    (folder / "bench_01" / "work_3.csv").write_text("time_s,voltage_V,force_N\n0,1")
    return folder


def test_an_archive_is_diagnosed_once_and_a_damaged_recording_costs_one_line(archive, tmp_path):
    done = piezod("history", archive, "-o", tmp_path / "out", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("bench_01/")]
    assert len(lines) == 1
    assert lines[0].startswith("bench_01/work_3.csv: work_3.csv")
    assert "3 recordings of 1 benches; benches that changed: 0" in done.stdout
    assert (tmp_path / "out" / "fleet.html").is_file()
    assert (tmp_path / "out" / "bench_01" / "history.html").is_file()
    run = tmp_path / "out" / "bench_01" / "work_1.csv" / "run.json"
    written = run.stat().st_mtime_ns
    again = piezod("history", archive, "-o", tmp_path / "out", "--json")
    assert again.returncode == 0, again.stderr
    assert again.stderr == ""
    assert run.stat().st_mtime_ns == written
    recordings = json.loads(again.stdout)["benches"]["bench_01"]["recordings"]
    assert [one["verdict"] for one in recordings] == ["matches", "matches", None]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--csv", "table.csv"), "--csv is for models"),
        (("--jobs", 2, "--scheduler", "x:1"), "give one of them"),
    ],
)
def test_a_refused_archive_command_says_why(archive, arguments, said):
    done = piezod("history", archive, *arguments)
    assert done.returncode == 2
    assert said in done.stderr
