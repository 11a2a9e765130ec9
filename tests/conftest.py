"""Settings that every test shares, and the order in which workers take the tests.

Each file is one group, which one worker runs from its first test to its last, so that it sets a shared bench up once.
Tests marked `real_time` judge deadlines of the real clock. They are the last groups, and run beside each other only.
"""

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("piezod", deadline=None)  # timing is a benchmark, never an assertion
settings.load_profile("piezod")

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # one worker a core; children inherit it
    os.environ.setdefault(name, "1")

ORDER = ("tests/end_to_end/", "tests/unit/diagnose/", "tests/contract/", "tests/", "real time")
"""Groups by what their names start with: those that take longest come first."""

REAL_TIME_GROUP = 20  # tests of a real-time group: few, so that the workers end at about the same time


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items):
    """Put every test into its group, and the groups into their order."""
    real_time = [item for item in items if item.get_closest_marker("real_time") is not None]
    place = {item.nodeid: k // REAL_TIME_GROUP for k, item in enumerate(real_time)}
    for item in items:
        number = place.get(item.nodeid)
        group = item.nodeid.partition("::")[0] if number is None else f"real time {number}"
        item.add_marker(pytest.mark.xdist_group(group))
    items.sort(key=_place)


def _place(item):
    group = item.get_closest_marker("xdist_group").args[0]
    return next(place for place, start in enumerate(ORDER) if group.startswith(start))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Run a real-time test while no worker runs a test of another kind."""
    worker = getattr(item.config, "workerinput", {})  # not the environment: a pytest that a test starts inherits that
    with _alone_with_its_kind(worker.get("testrunuid"), real_time=item.get_closest_marker("real_time") is not None):
        return (yield)


@contextlib.contextmanager
def _alone_with_its_kind(run, *, real_time):
    """Wait for the tests of the other kind.

    A test holds the lock of its kind together with the others of its kind. It begins when it has had both locks, one of
    them alone, so that no test of the other kind is running. Every test takes the two locks in the same order.
    """
    if run is None:
        yield
        return
    with _lock_file(run, "usual").open("w") as usual, _lock_file(run, "real_time").open("w") as timed:
        fcntl.flock(usual, fcntl.LOCK_EX if real_time else fcntl.LOCK_SH)
        fcntl.flock(timed, fcntl.LOCK_SH if real_time else fcntl.LOCK_EX)
        fcntl.flock(usual if real_time else timed, fcntl.LOCK_UN)
        yield


def _lock_file(run, kind):
    return Path(tempfile.gettempdir()) / f"piezod-tests-{run}-{kind}.lock"


def pytest_unconfigure(config):
    """Remove the locks of the run when its workers have ended."""
    if run := getattr(config.pluginmanager.get_plugin("dsession"), "testrunuid", None):
        for kind in ("usual", "real_time"):
            _lock_file(run, kind).unlink(missing_ok=True)
