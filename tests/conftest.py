"""Settings that every test shares, and the order in which workers take the tests.

Each file is one group, which one worker runs from its first test to its last, so that it sets a shared bench up once.
Tests marked `real_time` judge deadlines of the real clock. They are the last group, and run while no other test does.
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

ORDER = ("tests/simulation/", "tests/end_to_end/", "tests/unit/diagnose/", "tests/contract/", "tests/", "real time")
"""Groups by what their names start with: those that take longest come first."""


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items):
    """Put every test into its group, and the groups into their order."""
    for item in items:
        real_time = item.get_closest_marker("real_time") is not None
        item.add_marker(pytest.mark.xdist_group("real time" if real_time else item.nodeid.partition("::")[0]))
    items.sort(key=_place)


def pytest_collection_finish(session):
    """Refuse to run where the workers would not see the groups: pytest 9.2 hides them from pytest-xdist 3.8."""
    if getattr(session.config.option, "loadgroup", False):
        for item in session.items:
            if "@" not in item.nodeid:
                raise pytest.UsageError(f"{item.nodeid}: its group is lost; install pytest below 9.2")


def _place(item):
    group = item.get_closest_marker("xdist_group").args[0]
    return next(place for place, start in enumerate(ORDER) if group.startswith(start))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """A test holds the lock of the run together with other tests, a real-time test holds it alone."""
    worker = getattr(item.config, "workerinput", {})  # not the environment: a pytest that a test starts inherits that
    with _lock(worker.get("testrunuid"), alone=item.get_closest_marker("real_time") is not None):
        return (yield)


@contextlib.contextmanager
def _lock(run, *, alone):
    if run is None:
        yield
        return
    with (Path(tempfile.gettempdir()) / f"piezod-tests-{run}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        yield


def pytest_unconfigure(config):
    """Remove the lock of the run when its workers have ended."""
    if run := getattr(config.pluginmanager.get_plugin("dsession"), "testrunuid", None):
        (Path(tempfile.gettempdir()) / f"piezod-tests-{run}.lock").unlink(missing_ok=True)
