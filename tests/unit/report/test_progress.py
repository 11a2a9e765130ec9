"""A progress bar appears on a terminal after two seconds and disappears at the end."""

import os
import pty
import subprocess
import sys

import pytest

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
