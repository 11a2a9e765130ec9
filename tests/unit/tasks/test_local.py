"""Tasks in processes of this machine."""

import zlib

from piezod.tasks.isolated import run_locally
from piezod.tasks.task import Task, failed_outcome

MODULE = "tests.unit.tasks.echo"


def task(name, text):
    return Task(name, {"text": zlib.compress(text.encode())}, MODULE)


def test_a_task_that_becomes_ready_by_an_outcome_is_run_too():
    waiting = [[task("first", "1")], [], []]

    def take():
        return waiting[0].pop() if waiting[0] else None

    found = []
    for outcome in run_locally(take, jobs=2):
        found.append((outcome.name, outcome.files["text"]))
        waiting.pop(0)
        if outcome.name == "first":
            waiting[0].append(task("second", "2"))
    assert found == [("first", b"1"), ("second", b"2")]


def test_errors_and_dead_processes_are_failures_in_one_line():
    waiting = [task("raises", "raise"), task("dies", "die"), failed_outcome("unread", "no\nfile")]
    reasons = {one.name: one.failed for one in run_locally(lambda: waiting.pop() if waiting else None, jobs=1)}
    assert reasons == {
        "raises": "ValueError in echo.py, line 15: raise",
        "dies": "its process ended with 3, 3 times",
        "unread": "no file",
    }
