"""Settings that every test shares; tests marked `alone` run last, while no other worker runs a test."""

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


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Tests marked `alone` go to the end: until then every worker has something to do."""
    items.sort(key=lambda item: item.get_closest_marker("alone") is not None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """A test holds the lock of the run together with other tests, a test marked `alone` holds it alone."""
    with _lock(alone=item.get_closest_marker("alone") is not None):
        return (yield)


@contextlib.contextmanager
def _lock(*, alone):
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
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
