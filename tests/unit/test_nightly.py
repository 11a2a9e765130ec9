"""The nightly rows: they count for sixty commits, a red one never; a row that did not run ages too."""

import json
import subprocess
import sys
import time

import pytest

from tests import nightly
from tests.nightly import MOST_COMMITS, Command, Row, commands, read, refusals, reported, unfinished, work, write
from tests.simulation import mutations


def git(folder, *arguments):
    user = ("-c", "user.name=a test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *user, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def commit(folder, times=1):
    for _ in range(times):
        git(folder, "commit", "-q", "--allow-empty", "-m", "A change")
    return git(folder, "rev-parse", "--short=12", "HEAD")


@pytest.fixture
def clone(tmp_path):
    git(tmp_path, "init", "-q")
    return tmp_path


@pytest.mark.parametrize("row", [Row("", 1.0, "green", "passed"), Row("", 9.0, "yellow", "nothing finds it"), Row("")])
def test_a_row_counts_until_it_is_sixty_commits_old_and_so_does_one_that_never_ran(clone, row):
    row.commit = commit(clone)
    file = clone / "nightly.json"
    write(file, {"slow: a": row})
    commit(clone, MOST_COMMITS)
    assert refusals(file, clone) == []
    commit(clone)
    old = f"{file}: 1 rows are of commit {row.commit}, 61 commits old, must be at most 60; "
    assert refusals(file, clone) == [f"{old}run `python -m tests.nightly` and commit tests/nightly.json"]


def test_a_red_row_never_counts(clone):
    file = clone / "nightly.json"
    write(file, {"fuzz": Row(commit(clone), 1.0, "red", "3 failed"), "slow: a": Row(commit(clone), 1.0, "green", "")})
    assert refusals(file, clone) == [f"{file}: fuzz is red: 3 failed"]


def test_a_row_of_a_commit_that_the_history_lacks_does_not_count(clone):
    commit(clone)
    file = clone / "nightly.json"
    write(file, {"fuzz": Row("0123456789ab", 1.0, "green", "")})
    assert ["commit 0123456789ab, which this history lacks" in reason for reason in refusals(file, clone)] == [True]


def test_without_the_whole_history_no_age_is_judged_and_that_is_said_but_a_red_row_still_fails(
    clone, tmp_path_factory, capsys
):
    folder = tmp_path_factory.mktemp("elsewhere")
    file = folder / "nightly.json"
    assert "no rows" in refusals(file, clone)[0]
    write(file, {"fuzz": Row("0123456789ab", 1.0, "green", ""), "slow: a": Row(commit(clone), 1.0, "red", "1 failed")})
    git(folder, "clone", "-q", "--depth", "1", f"file://{clone}", "shallow")
    for place in (folder, folder / "shallow"):
        assert refusals(file, place) == [f"{file}: slow: a is red: 1 failed"]
        assert "the age of the rows is not judged" in capsys.readouterr().out
    git(folder, "clone", "-q", f"file://{clone}", "whole")
    assert len(refusals(file, folder / "whole")) == 2


def test_a_test_is_as_good_as_its_worst_phase_and_has_a_row_after_its_last_one():
    lines = [
        ["t::a", "setup", "passed", 1.0, ""], ["t::a", "call", "passed", 2.0, ""],
        ["t::a", "teardown", "failed", 0.5, "E left a process\nmore"],
        ["t::b", "setup", "passed", 1.0, ""], ["t::b", "teardown", "passed", 0.0, ""],
        ["t::c", "setup", "skipped", 0.0, "no mosquitto"], ["t::c", "teardown", "passed", 0.0, ""],
        ["t::killed", "setup", "passed", 1.0, ""],
    ]  # fmt: skip
    rows = reported(map(json.dumps, lines), "c", "slow")
    assert rows == {
        "slow: t::a": Row("c", 3.5, "red", "failed: E left a process"),
        "slow: t::b": Row("c", 1.0, "green", "passed"),
        "slow: t::c": Row("c", 0.0, "grey", "skipped: no mosquitto"),
    }


def test_red_rows_come_first_then_those_that_never_ran_then_the_oldest_and_none_twice():
    head, before = (nightly.git("rev-parse", f"HEAD{back}") or "" for back in ("", "~1"))
    if not before:
        pytest.skip("needs the history of a clone")
    rows = {
        "done": Row(head, 1.0, "green", ""), "skipped": Row(head, 1.0, "grey", "skipped"), "never": Row(head),
        "old": Row(before, 9.0, "green", ""), "lost": Row("0123456789ab", 9.0, "green", ""),
        "quick": Row(before, 1.0, "yellow", ""), "red": Row(before, 1.0, "red", ""),
    }  # fmt: skip
    assert unfinished(rows, rows, head) == ["red", "never", "lost", "quick", "old"]


@pytest.mark.parametrize(
    ("program", "colour", "figure"),
    [("print('3 of 3 exact')", "green", "3 of 3 exact"), ("print('2 of 3; not: creep')", "red", "2 of 3; not: creep"),
     ("print('bad'); raise SystemExit(1)", "red", "bad")],
)  # fmt: skip
def test_a_command_is_red_by_its_exit_code_or_by_its_last_line(tmp_path, monkeypatch, program, colour, figure):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # also where the current folder is no place of modules
    (tmp_path / "one_command.py").write_text(program, encoding="utf-8")
    monkeypatch.setattr(nightly, "ROOT", tmp_path)
    row = Command(["one_command"], bad="; not: ").run("c", 60.0)
    assert (row.colour, row.figure) == (colour, figure)


def test_what_the_time_is_too_short_for_stays_as_it_was_and_ends(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # also where the current folder is no place of modules
    (tmp_path / "long_command.py").write_text("import time; time.sleep(60)", encoding="utf-8")
    monkeypatch.setattr(nightly, "ROOT", tmp_path)
    rows, news = {"fuzz": Row("c")}, []
    work(rows, ["fuzz"], "c", {"fuzz": Command(["long_command"])}, time.monotonic() + 0.5, news.append)
    assert news == [{}]


def test_tests_that_pytest_ends_without_are_red(tmp_path, monkeypatch):
    (tmp_path / "test_it.py").write_text("import os\ndef test_one(): pass\ndef test_two(): os._exit(3)\n", "utf-8")
    monkeypatch.setattr(nightly, "ROOT", tmp_path)
    monkeypatch.setattr(nightly, "MARKS", {"slow": ""})
    monkeypatch.setenv("PYTHONPATH", str(nightly.FILE.parents[1]))
    monkeypatch.setattr(nightly, "FILE", tmp_path / "nightly.json")
    rows = nightly.run_tests("slow", ["test_it.py::test_one", "test_it.py::test_two"], "c", 60.0)
    assert {name: row.colour for name, row in rows.items()} == {
        "slow: test_it.py::test_one": "green",
        "slow: test_it.py::test_two": "red",
    }


def test_the_commit_draws_the_mutations_and_the_seeds():
    one, other = commands("aaaaaaaaaaaa"), commands("bbbbbbbbbbbb")
    assert one.keys() == other.keys()
    assert one["simulation: swarm"].arguments == commands("aaaaaaaaaaaa")["simulation: swarm"].arguments
    assert one["simulation: swarm"].arguments != other["simulation: swarm"].arguments
    mutations = [{row.name for name, row in rows.items() if name.startswith("mutation")} for rows in (one, other)]
    assert len(mutations[0]) == nightly.MUTATIONS
    assert mutations[0] != mutations[1]


def test_a_file_is_read_as_it_was_written(tmp_path):
    rows = {"b": Row("c", 1.5, "red", 'failed: "x"'), "a": Row("c")}
    write(tmp_path / "nightly.json", rows)
    assert read(tmp_path / "nightly.json") == rows


def test_a_command_that_ignores_its_end_is_killed(tmp_path, monkeypatch):
    program = (
        "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('on', flush=True); time.sleep(60)"
    )
    monkeypatch.setattr(nightly, "ROOT", tmp_path)
    monkeypatch.setattr(nightly, "ENDED_S", 0.2)
    assert nightly.run([sys.executable, "-c", program], 2.0) == (None, "on\n")


def test_each_mutated_module_has_unit_tests():
    """Without them pytest ends with an error, which would look as if a test had found the mutation."""
    for module, room in mutations.MODULES.items():
        name = module.rpartition(".")[2]
        file = f"test_{mutations.NAMED_OTHERWISE.get(name, name)}.py"
        assert (mutations.ROOT / "tests" / "unit" / room / file).exists(), f"{module}: {file} is missing"


@pytest.mark.parametrize("left_s", [10.0, 3 * mutations.WITHIN_S - 1.0])
def test_a_mutation_is_not_judged_by_the_end_of_the_time(left_s):
    assert nightly.Mutation(mutations.every()[0]).run("c", left_s) is None
