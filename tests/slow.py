"""The command that runs the tests marked `slow`, and writes their results into `tests/README.md`.

    python -m tests.slow                  # all of them
    python -m tests.slow tests/studies    # those below a path; the table in the README stays as it is

The workers of pytest run the tests at the same time, so a time of this table is longer than that of a test alone.
"""

import datetime as dt
import sys
import time
from pathlib import Path

import pytest

README = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- slow: begin -->", "<!-- slow: end -->"
RED = 1


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

    def table(self, total_s):
        """Markdown table of the tests, the date and the total time."""
        date = dt.datetime.now(tz=dt.UTC).date().isoformat()
        count = {word: list(self.outcomes.values()).count(word) for word in ("passed", "failed", "skipped")}
        counts = ", ".join(f"{number} {word}" for word, number in count.items() if number)
        rows = [
            f"| `{name.removeprefix('tests/')}` | {self.outcomes[name]} | {self.seconds[name]:.0f} s |"
            for name in sorted(self.outcomes)
        ]
        return "\n".join(
            [f"{date}: {counts}, {total_s:.0f} s in all", "", "| test | result | time |", "|---|---|---|", *rows]
        )


def written(text, table):
    """Text of the README with the table between its two markers; the markers come last where they are missing."""
    if BEGIN not in text:
        text = f"{text.rstrip()}\n\n## Slow tests\n\n    python -m tests.slow\n\n{BEGIN}\n{END}\n"
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.partition(END)[2]}"


def main(paths):
    """Run, print the table, and write it when no path narrows the run; returns pytest's exit code."""
    results, begun_s = Results(), time.monotonic()
    code = pytest.main(["-m", "slow", *paths], plugins=[results])
    table = results.table(time.monotonic() - begun_s)
    print(table)
    if not paths and code <= RED:
        README.write_text(written(README.read_text(encoding="utf-8"), table), encoding="utf-8")
    return int(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
