"""The concealed study as commands: drawn, judged here and on a cluster of processes on loopback, stopped, scored."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from piezod.recording import Recording, read_csv, write_csv
from tests.benches.emulator import piezod

SEED = 13  # its cases are short
FOREIGN_SEED = 12  # nothing comes near it
FILES = {"findings.json", "run.json", "simulated_held_out.csv", "simulated_held_out_base.csv", "replay.json"}
LONG_S = 600.0  # after which a command hangs; no time is judged here


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind") / "study"
    done = piezod("blind", "make", folder, "--cases", 3, "--kind", "null", "--seed", SEED, "--jobs", 2)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def bare(study):
    """The study without its sealed truth, and its held-out records without the force."""
    folder = study.parent / "bare"
    shutil.copytree(study, folder, ignore=shutil.ignore_patterns("*sealed"))
    for path in folder.glob("case_*/held_out.csv"):
        record = read_csv(path)
        write_csv(Recording(record.time_s, {k: v for k, v in record.channels.items() if k != "force_N"}), path)
    return folder


@pytest.fixture(scope="module")
def judged(bare):
    folder = bare.parent / "verdicts"
    done = piezod("blind", "run", bare, "-o", folder, "--jobs", 2)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[0] == f"{folder}: 3 cases diagnosed, 0 failed, 0 were already done"
    assert f"blind score {bare} {folder}" in done.stdout
    return folder


def verdict(folder):
    """Findings, simulations and what else was written, without how long it took."""
    assert {path.name for path in folder.iterdir()} == FILES
    findings, run = (json.loads((folder / name).read_text()) for name in ("findings.json", "run.json"))
    assert run.pop("elapsed_s") > 0.0
    assert run.pop("identification_s") > 0.0
    return findings, run, *(read_csv(folder / name).channel("force_N") for name in sorted(FILES) if "held_out" in name)


def same(one, other):
    """Equal but for the last digits, which sums over memory that lies elsewhere may change."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, (str, type(None))):
        return one == other
    return one == pytest.approx(other, rel=1e-6, abs=1e-6)


def names(folder):
    return sorted(path.name for path in folder.glob("case_*"))


@contextlib.contextmanager
def cluster(folder):
    """A scheduler and two workers, each a process of its own; yields the address and the workers."""
    file, started = folder / "scheduler.json", []

    def start(*arguments):
        command = [sys.executable, "-m", "dask", *map(str, arguments), "--no-dashboard", "--host", "127.0.0.1"]
        started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    try:
        start("scheduler", "--port", 0, "--scheduler-file", file)
        until(lambda: file.exists() and file.read_text().endswith("}"), started[0])
        for number in range(2):
            options = ("--nthreads", 1, "--no-nanny", "--local-directory", folder / f"worker_{number}")
            start("worker", "--scheduler-file", file, *options)
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(timeout=20)


def until(holds, process):
    """Wait until something holds; what is returned is what held."""
    ends_s = time.monotonic() + LONG_S
    while not (found := holds()):
        assert process.poll() is None
        assert time.monotonic() < ends_s
        time.sleep(0.02)
    return found


def judging(pid):
    """Processes under this one that judge a case."""
    found = []
    for child in psutil.Process(pid).children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            if "piezod.blind.worker" in child.cmdline():
                found.append(child)
    return found


def running(*arguments):
    # A background job of a shell, as a test run may be, is started with SIGINT ignored, and so would be its children.
    hears = ["env", "--default-signal=INT"]
    command = [*hears, sys.executable, "-m", "piezod", "blind", "run", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_what_no_effect_explains_leaves_the_model_as_it_was(tmp_path):
    made = piezod("blind", "make", tmp_path / "study", "--cases", 1, "--kind", "foreign", "--seed", FOREIGN_SEED)
    assert made.returncode == 0, made.stderr
    done = piezod("blind", "run", tmp_path / "study", "-o", tmp_path / "verdicts", "--jobs", 1, timeout=LONG_S)
    assert done.returncode == 0, done.stdout + done.stderr
    findings, _, extended, base = verdict(tmp_path / "verdicts" / "case_0001")
    assert findings["verdict"] == "unexplained"
    assert findings["effects"] == []
    assert findings["fit"]["held_out"]["gap_closed"] == 0.0
    np.testing.assert_array_equal(extended, base)


@pytest.mark.slow
def test_the_cases_are_judged_without_the_truth_and_then_scored_with_it(study, judged):
    for name in names(study):
        findings, run, *_ = verdict(judged / name)
        assert findings["schema"] == "piezod.findings/2"
        assert findings["recordings"][0]["path"] == "identification.csv"
        assert run["failed"] is None
    done = piezod("blind", "score", study, judged, "--json")
    assert done.returncode == 0, done.stderr
    assert sorted(json.loads(done.stdout)["cases"]) == names(study)
    done = piezod("blind", "score", study, judged)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1].startswith("false alarm on nulls")
    assert "counted as wrong" not in done.stdout


@pytest.mark.slow
def test_a_cluster_whose_workers_see_no_file_of_ours_says_the_same(bare, judged, tmp_path):
    with cluster(tmp_path) as (address, _):
        done = piezod("blind", "run", bare, "-o", tmp_path / "verdicts", "--scheduler", address)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(" of 3 cases" in line for line in done.stderr.splitlines()), done.stderr  # progress, of a slow run
    assert names(tmp_path / "verdicts") == names(judged)
    for name in names(judged):
        assert same(verdict(tmp_path / "verdicts" / name), verdict(judged / name))


@pytest.mark.slow
def test_a_worker_of_the_cluster_that_is_killed_loses_no_case(bare, judged, tmp_path):
    with cluster(tmp_path) as (address, workers):
        run = running(bare, "-o", tmp_path / "verdicts", "--scheduler", address)
        orphan = until(lambda: judging(workers[0].pid), run)[0]
        workers[0].kill()
        out, err = run.communicate(timeout=LONG_S)
    assert run.returncode == 0, out + err
    assert "3 cases diagnosed, 0 failed" in out
    psutil.wait_procs([orphan], timeout=10)
    assert not orphan.is_running()
    for name in names(judged):
        assert same(verdict(tmp_path / "verdicts" / name), verdict(judged / name))


@pytest.mark.slow
def test_a_run_that_is_interrupted_leaves_nothing_behind_and_goes_on_where_it_stopped(bare, judged, tmp_path):
    folder = tmp_path / "verdicts"
    run = running(bare, "-o", folder, "--jobs", 1)
    until(lambda: names(folder) and judging(run.pid), run)
    left = judging(run.pid)
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=20)
    assert run.returncode == 130, out + err
    assert err == ""
    assert not any(process.is_running() for process in left)
    there = names(folder)
    assert 1 <= len(there) < 3
    assert sorted(path.name for path in folder.iterdir()) == [*there, "study.json"]
    done = piezod("blind", "run", bare, "-o", folder)
    begin = f"{folder}: {3 - len(there)} cases diagnosed, 0 failed, {len(there)} were already done\n"
    assert done.stdout.startswith(begin)
    for name in names(judged):
        assert same(verdict(folder / name), verdict(judged / name))


@pytest.mark.slow
def test_a_process_that_is_killed_is_started_again(bare, tmp_path):
    run = running(bare, "-o", tmp_path / "verdicts", "--only", "case_0001")
    os.kill(until(lambda: judging(run.pid), run)[0].pid, signal.SIGKILL)
    out, err = run.communicate(timeout=LONG_S)
    assert run.returncode == 0, out + err
    assert "1 cases diagnosed, 0 failed" in out


def test_a_case_that_fails_is_one_line_counts_as_wrong_and_is_tried_again(study, bare, tmp_path):
    broken, folder = tmp_path / "study", tmp_path / "verdicts"
    shutil.copytree(bare, broken)
    path = broken / "case_0002" / "identification.csv"
    whole = path.read_text()
    path.write_text(whole[: whole.index("\n") + 1])
    done = piezod("blind", "run", broken, "-o", folder, "--only", "case_0002")
    assert done.returncode == 1
    first, last, *step = done.stdout.splitlines()
    assert first.startswith("case_0002 failed: identification.csv")
    assert last.endswith("0 cases diagnosed, 1 failed, 0 were already done")
    assert "blind score" in " ".join(step)
    done = piezod("blind", "score", study, folder, "--partial")
    assert "1 cases without findings, counted as wrong" in done.stdout
    assert "1 of 1 cases with a failure" in done.stdout
    path.write_text(whole)
    done = piezod("blind", "run", broken, "-o", folder, "--only", "case_0002")
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("make", "STUDY", "--cases", 2), 78, "has a study already"),
        (("make", "NEW", "--cases", 2, "--kind", "odd"), 2, "argument --kind: invalid choice: 'odd'"),
        (("run", "NEW", "-o", "NEW"), 78, "has no seal.json"),
        (("run", "STUDY", "-o", "NEW", "--only", "case_0009"), 2, "has 3 cases, case_0001 to case_0003"),
        (("run", "STUDY", "-o", "NEW", "--scheduler", "odd://x"), 2, "unknown address scheme 'odd'"),
        (("run", "STUDY", "-o", "NEW", "--scheduler", "127.0.0.1:9"), 75, "no scheduler answers there"),
        (("run", "STUDY", "-o", "NEW", "--jobs", 2, "--scheduler", "x:1"), 2, "give one of them"),
        (("score", "STUDY", "NEW"), 78, "has no verdict"),
    ],
)
def test_a_refused_blind_command_prints_one_line_and_exits_with_its_code(study, tmp_path, arguments, code, said):
    places = {"STUDY": study, "NEW": tmp_path / "new"}
    done = piezod("blind", *(places.get(one, one) for one in arguments))
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stderr.startswith("piezod: ")
    assert done.stderr.count("\n") == 1
