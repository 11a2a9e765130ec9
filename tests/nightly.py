"""The nightly command: everything that is too long for each change, one row each, in `tests/nightly.json`.

    python -m tests.nightly [--within MINUTES]    # goes on where it stopped; red and old rows come first
    python -m tests.nightly --only slow           # rows whose names begin so
    python -m tests.nightly --show                # the table
    python -m tests.nightly --check               # no row is red, and none is more than sixty commits old

A row is a test marked `slow` or `real_time`, a short study, the fuzzer, a swarm of fresh seeds of the simulation, or a
mutation of the day. The commit draws seeds and mutations. A row that was never run is grey; it ages from the commit at
which it was first listed. A mutation that nothing finds is yellow: a missing test, or a change that means the same.
"""

import argparse
import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).with_suffix(".json")
MOST_COMMITS = 60  # age of a row that still describes the program
LONGEST_S, ENDED_S = 1800.0, 30.0  # of one command; from SIGTERM to SIGKILL
MARKS = {"slow": "slow", "real time": "real_time and not slow"}  # begin of a row's name, expression of pytest
MUTATIONS = 10
REPORTED = "PIEZOD_NIGHTLY"  # file that the plugin of pytest adds a line to for each test
RENEW = "run `python -m tests.nightly` and commit tests/nightly.json"


@dataclasses.dataclass
class Row:
    """What one row found at its commit, within `seconds`."""

    commit: str
    seconds: float = 0.0
    colour: str = "grey"
    figure: str = "not run"


def git(*arguments, folder=ROOT):
    """What git prints; None where it fails or is missing."""
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def read(file):
    """The rows of a file by name; none where there is no file."""
    text = file.read_text(encoding="utf-8") if file.exists() else "{}"
    return {name: Row(**row) for name, row in json.loads(text).items()}


def write(file, rows):
    """Write the rows, one on each line, at once."""
    lines = [f"{json.dumps(name)}: {json.dumps(dataclasses.asdict(rows[name]))}" for name in sorted(rows)]
    new = file.with_suffix(".new")
    new.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    new.replace(file)


def refusals(file, folder=ROOT):
    """Why the rows do not count for the checked-out commit, a line for each reason."""
    rows = read(file)
    if not rows:
        return [f"{file}: no rows, must be those of the nightly command; {RENEW}"]
    reasons = [f"{file}: {name} is red: {row.figure}" for name, row in rows.items() if row.colour == "red"]
    if git("rev-parse", "--is-shallow-repository", folder=folder) != "false":
        print(f"{folder}: no git history or a part of it, so that the age of the rows is not judged")
        return reasons
    for commit in sorted({row.commit for row in rows.values()}):
        count = sum(row.commit == commit for row in rows.values())
        behind = git("rev-list", "--count", f"{commit}..HEAD", folder=folder)
        if behind is None:
            reasons.append(f"{file}: {count} rows are of commit {commit}, which this history lacks; {RENEW}")
        elif int(behind) > MOST_COMMITS:
            reasons.append(
                f"{file}: {count} rows are of commit {commit}, {behind} commits old, must be at most {MOST_COMMITS}; "
                f"{RENEW}"
            )
    return reasons


def pytest_runtest_logreport(report):
    """Add a line for each phase of a test to the file that the environment names (this module as a plugin)."""
    if path := os.environ.get(REPORTED):
        why = getattr(getattr(report.longrepr, "reprcrash", None), "message", str(report.longrepr or ""))
        if report.skipped and isinstance(report.longrepr, tuple):
            why = report.longrepr[2]
        line = [report.nodeid, report.when, report.outcome, report.duration, why.strip()]
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def reported(lines, commit, mark):
    """Rows of the tests whose last phase is there: a test is as good as its worst phase."""
    rows, ended = {}, set()
    for text in lines:
        test, phase, outcome, seconds, why = json.loads(text)
        ended |= {f"{mark}: {test}"} if phase == "teardown" else set()
        row = rows.setdefault(f"{mark}: {test}", Row(commit, 0.0, "green", "passed"))
        row.seconds = round(row.seconds + seconds, 1)
        if outcome != "passed" and row.colour != "red":
            row.colour = "red" if outcome == "failed" else "grey"
            row.figure = f"{outcome}: {why.splitlines()[0][:160]}" if why else outcome
    return {name: row for name, row in rows.items() if name in ended}


def run(command, within_s, environment=None):
    """Exit code and output of a command; code None: it took longer, and it and its children were ended."""
    started = subprocess.Popen(
        command, cwd=ROOT, env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    for ending, time_s in ((None, within_s), (signal.SIGTERM, ENDED_S), (signal.SIGKILL, None)):
        if ending is not None:
            os.killpg(started.pid, ending)
        with contextlib.suppress(subprocess.TimeoutExpired):
            output, _ = started.communicate(timeout=time_s)
            break
    return (started.returncode if ending is None else None), output


PYTEST = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider"]


def tests_of(mark):
    """Names of the tests with a mark."""
    code, output = run([*PYTEST, "--collect-only", "-m", MARKS[mark]], LONGEST_S)
    if code:
        sys.exit(f"tests cannot be collected:\n{output}")
    return [line for line in output.splitlines() if line.startswith("tests/") and "::" in line]


def run_tests(mark, tests, commit, within_s):
    """Rows of the tests that ended within a time, those of one file."""
    path = FILE.with_suffix(f".{os.getpid()}")
    path.touch()
    try:
        command = [*PYTEST, "-p", "tests.nightly", "-m", MARKS[mark], *tests]
        code, output = run(command, within_s, os.environ | {REPORTED: str(path)})
        rows = reported(path.read_text(encoding="utf-8").splitlines(), commit, mark)
    finally:
        path.unlink()
    unended = [test for test in tests if f"{mark}: {test}" not in rows]
    if unended and code is not None:
        last = output.strip().splitlines()[-1][:160]
        rows |= {f"{mark}: {test}": Row(commit, 0.0, "red", f"pytest ended without it: {last}") for test in unended}
    elif unended and within_s >= LONGEST_S:
        rows[f"{mark}: {unended[0]}"] = Row(commit, within_s, "red", f"not ended within {within_s:.0f} s")
    return rows


@dataclasses.dataclass
class Command:
    """A command whose last line is its figure; red with another exit code than 0, or with `bad` in that line."""

    arguments: list
    bad: str = r"(?!)"

    def run(self, commit, within_s):
        """The row; None: the time was too short."""
        begun_s = time.monotonic()
        code, output = run([sys.executable, "-m", *self.arguments], min(within_s, LONGEST_S))
        if code is None and within_s < LONGEST_S:
            return None
        last = (output.strip().splitlines() or [""])[-1]
        red = code != 0 or re.search(self.bad, last)
        figure = last[:300] if code is not None else f"not ended within {LONGEST_S:.0f} s"
        return Row(commit, round(time.monotonic() - begun_s, 1), "red" if red else "green", figure)


class Mutation:
    """A mutation of the day: green where something finds it."""

    def __init__(self, name):
        self.name = name

    def run(self, commit, within_s):
        """The row; None: the time was too short."""
        from tests.simulation.mutations import WITHIN_S, Changed, killed_by

        if within_s < 3 * WITHIN_S:  # its steps at most: an end of the time would look as if they had found it
            return None
        found, took_s = killed_by(self.name, quick=False)
        text = f"{self.name} {Changed(self.name).text}: {found or 'nothing finds it'}"
        return Row(commit, round(took_s, 1), "green" if found else "yellow", text[:300])


def commands(commit):
    """The rows that are no tests, by name."""
    from tests.simulation.mutations import every

    draw = int(hashlib.sha256(commit.encode()).hexdigest()[:6], 16)  # seeds that a person can type
    rows = {
        "study: scenarios": Command(["tests.studies", "scenarios", "--short", "--jobs", "1"], bad="; not: "),
        "study: learning": Command(["tests.studies", "learning", "--jobs", "1"], bad=r"without learning: (?!none)"),
        "study: recorder": Command(["tests.studies", "recorder", "--short"]),
        "fuzz": Command(["tests.fuzz", "--seed", str(draw)]),
        "simulation: rows": Command(["tests.simulation.rows"]),
        "simulation: swarm": Command(
            ["tests.simulation", "--seeds", "100", "--seconds", "15", "--first", str(draw)], bad="[1-9][0-9]* with viol"
        ),
    }
    drawn = random.Random(draw).sample(every(), MUTATIONS)
    return rows | {f"mutation {number}": Mutation(name) for number, name in enumerate(drawn, 1)}


def unfinished(rows, names, head):
    """Names without a result of this commit: red ones first, then the oldest, then the quickest."""

    @functools.cache
    def age(commit):
        behind = git("rev-list", "--count", f"{commit}..{head}")
        return MOST_COMMITS + 1 if behind is None else int(behind)

    def place(name):
        row = rows[name]
        return row.colour != "red", row.colour != "grey", -age(row.commit), row.seconds

    return sorted((name for name in names if rows[name].commit != head or rows[name].figure == "not run"), key=place)


def work(rows, names, head, listed, end_s, done):
    """Run rows until the end of the time; tests of one file run together. `done` is called with what is new."""
    waiting = unfinished(rows, names, head)
    while waiting and (left_s := end_s - time.monotonic()) > 0.0:
        name = waiting[0]
        if name in listed:
            row = listed[name].run(head, left_s)
            new, ran = {} if row is None else {name: row}, {name}
        else:
            mark, start = name.partition(": ")[0], f"{name.partition('::')[0]}::"
            ran = {one for one in waiting if one.startswith(start)}
            tests = [one.partition(": ")[2] for one in waiting if one in ran]
            new = run_tests(mark, tests, head, min(left_s, LONGEST_S))
        waiting = [one for one in waiting if one not in ran]
        done(new)


def table(rows):
    """The rows as text, and their counts."""
    lines = [f"{row.colour:<6} {row.seconds:>7.1f} s  {row.commit}  {name}: {row.figure}" for name, row in rows.items()]
    colours = [row.colour for row in rows.values()]
    counts = ", ".join(f"{colours.count(one)} {one}" for one in ("green", "yellow", "red", "grey"))
    return [*lines, f"{len(rows)} rows: {counts}; {sum(row.seconds for row in rows.values()):.0f} s"]


def nightly(only, within_s):
    """Run what is to be run, and write each result as it comes; returns the exit code."""
    begun_s, head = time.monotonic(), git("rev-parse", "--short=12", "HEAD")
    if head is None or git("status", "--porcelain", "--untracked-files=no", "--", ".", f":!{FILE}"):
        sys.exit(f"{ROOT}: changed files belong to no commit; commit them before the nightly rows are run")
    listed = commands(head)
    names = [f"{mark}: {test}" for mark in MARKS for test in tests_of(mark)] + list(listed)
    old = read(FILE)
    rows = {name: old.get(name, Row(head)) for name in names}

    def done(new):
        rows.update(new)
        write(FILE, rows)
        for line in table(new)[:-1]:
            print(line, flush=True)

    write(FILE, rows)
    work(rows, [name for name in names if name.startswith(only)], head, listed, begun_s + within_s, done)
    print(table(rows)[-1], f"in rows; {time.monotonic() - begun_s:.0f} s now")
    return int(any(row.colour == "red" for row in rows.values()))


def main():
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.nightly", description=__doc__)
    parser.add_argument("--within", type=float, default=600.0, metavar="MINUTES", help="time to run (%(default)g)")
    parser.add_argument("--only", default="", metavar="START", help="rows whose names begin so")
    parser.add_argument("--show", action="store_true", help="print the table")
    parser.add_argument("--check", action="store_true", help="say why the rows do not count; exit code 1")
    wanted = parser.parse_args()
    if wanted.show:
        print("\n".join(table(read(FILE))))
        return 0
    if wanted.check:
        reasons = refusals(FILE)
        print("\n".join(reasons) or table(read(FILE))[-1])
        return int(bool(reasons))
    return nightly(wanted.only, 60.0 * wanted.within)


if __name__ == "__main__":
    sys.exit(main())
