"""A progress bar appears on a terminal after two seconds and disappears at the end."""

import os
import pty
import subprocess
import sys

import numpy as np
import pytest

from piezod.report import progress

PROGRAM = """
import time
from piezod.report import progress
with progress.steps({show_after_s}) as show:
    time.sleep(0.05)
    show("reading rec.csv, 1.0 million samples", None)
    show("fitting", 0.5)
print("done")
"""


def seen_on_a_terminal(show_after_s, *, stdout_too=True):
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(show_after_s=show_after_s)],
        stdin=theirs,
        stdout=theirs if stdout_too else subprocess.DEVNULL,
        stderr=theirs,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(theirs)
    seen = b""
    try:
        while part := os.read(ours, 4096):
            seen += part
    except OSError:
        pass  # the other end is closed
    os.close(ours)
    assert process.wait(timeout=30) == 0
    return seen.decode()


def test_a_long_task_shows_its_step_and_completed_share():
    seen = seen_on_a_terminal(0.0)
    assert "fitting" in seen
    assert "50%" in seen


@pytest.mark.parametrize(("show_after_s", "stdout_too"), [(2.0, True), (0.0, False)])
def test_a_short_or_piped_task_shows_no_bar(show_after_s, stdout_too):
    assert seen_on_a_terminal(show_after_s, stdout_too=stdout_too) == ("done\r\n" if stdout_too else "")


def test_without_a_terminal_a_line_says_how_long_the_rest_takes(monkeypatch, capsys):
    now_s = iter([100.0, 104.0, 112.0, 115.0, 124.0])
    monkeypatch.setattr("piezod.report.progress.time.monotonic", lambda: next(now_s))
    with progress.steps() as show:
        for share in (0.1, 0.25, 0.5, None):
            show("fitting", share)
    assert capsys.readouterr().err == "fitting, 25 %, 12 s taken, about 36 s left\nfitting, 24 s taken\n"


def test_without_a_terminal_a_drive_says_how_far_it_is(monkeypatch, capsys):
    now_s = iter([0.0, 11.0])
    monkeypatch.setattr("piezod.report.progress.time.monotonic", lambda: next(now_s))
    rows = np.array([(5_000_000_000,), (16_000_000_000,)], dtype=[("time_ns", "i8")])
    with progress.progress("staircase", 44.0) as show:
        show(rows[:0])
        show(rows)
    assert capsys.readouterr().err == "staircase, 25 %, 11 s taken, about 33 s left\n"
