"""The command that runs the tests marked `slow`, and writes their results into `tests/README.md`.

    python -m tests.slow                  # all of them
    python -m tests.slow tests/studies    # those below a path; the table in the README stays as it is
    python -m tests.slow --check          # no test: whether the table is at most thirty commits old

The workers of pytest run the tests at the same time, so a time of this table is longer than that of a test alone.
"""

import datetime as dt
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- slow: begin -->", "<!-- slow: end -->"
RED = 1
MOST_COMMITS = 30  # age of a table that still describes the tests
RENEW = "run `python -m tests.slow` and commit the table"


class Results:
    """Collects the result and the duration [s] of each test.

    With workers, pytest calls the hooks of this plugin in the process that starts the workers.
    """

    def __init__(self):
        self.seconds, self.outcomes = {}, {}

    def pytest_runtest_logreport(self, report):
        """Add one phase (setup, call or teardown) of a test."""
        name = report.nodeid.partition("@")[0]  # without the group
        self.seconds[name] = self.seconds.get(name, 0.0) + report.duration
        if report.outcome != "passed" or name not in self.outcomes:
            self.outcomes[name] = report.outcome

    def table(self, total_s, commit):
        """Markdown table of the tests, the date, the commit and the total time."""
        date = dt.datetime.now(tz=dt.UTC).date().isoformat()
        count = {word: list(self.outcomes.values()).count(word) for word in ("passed", "failed", "skipped")}
        counts = ", ".join(f"{number} {word}" for word, number in count.items() if number)
        rows = [
            f"| `{name.removeprefix('tests/')}` | {self.outcomes[name]} | {self.seconds[name]:.0f} s |"
            for name in sorted(self.outcomes)
        ]
        return "\n".join(
            [
                f"{date}, commit {commit}: {counts}, {total_s:.0f} s in all",
                "",
                "| test | result | time |",
                "|---|---|---|",
                *rows,
            ]
        )


def written(text, table):
    """Text of the README with the table between its two markers; the markers come last where they are missing."""
    if BEGIN not in text:
        text = f"{text.rstrip()}\n\n## Slow tests\n\n    python -m tests.slow\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.partition(END)[2]}"


def git(*arguments, folder=README.parent):
    """What git prints; None where it fails or is missing."""
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def refusal(readme):
    """Why the table in a README does not count for the checked-out commit, in one line; None: it counts."""
    table = readme.read_text(encoding="utf-8").partition(BEGIN)[2]
    named = re.match(r"\s*\S+, commit (?P<commit>[0-9a-f]{7,40})", table)
    if named is None:
        return f"{readme}: the table of the slow tests names no commit, must name the one that it was made on; {RENEW}"
    commit = named["commit"]
    age = git("rev-list", "--count", f"{commit}..HEAD", folder=readme.parent)
    if age is None:
        return f"{readme}: the table of the slow tests is of commit {commit}, which this history lacks; {RENEW}"
    if int(age) > MOST_COMMITS:
        return (
            f"{readme}: the table of the slow tests is of commit {commit}, {age} commits old, "
            f"must be at most {MOST_COMMITS}; {RENEW}"
        )
    return None


def check():
    """Print why the table does not count, and return the exit code."""
    reason = refusal(README)
    if reason is not None:
        print(reason, file=sys.stderr)
    return 0 if reason is None else RED


def run(paths):
    """Run the tests, print their table, write it when no path narrows the run; returns pytest's exit code."""
    results, begun_s = Results(), time.monotonic()
    commit = git("describe", "--always", "--exclude=*", "--abbrev=12", "--dirty") or "unknown"
    code = pytest.main(["-m", "slow", *paths], plugins=[results])
    table = results.table(time.monotonic() - begun_s, commit)
    print(table)
    if not paths and code <= RED:
        README.write_text(written(README.read_text(encoding="utf-8"), table), encoding="utf-8")
    return int(code)


if __name__ == "__main__":
    sys.exit(check() if sys.argv[1:] == ["--check"] else run(sys.argv[1:]))
