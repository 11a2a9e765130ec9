"""Settings that every test shares, and the order in which workers take the tests.

Each file is one group, which one worker runs from its first test to its last, so that it sets a shared bench up once.
Tests marked `real_time` are one group over all files: they wait for the real clock, at most one of them at a time, and
leave the cores to the others. They start first, then the files that take longest, then the rest.
"""

import os

import pytest
from hypothesis import settings

settings.register_profile("piezod", deadline=None)  # timing is a benchmark, never an assertion
settings.load_profile("piezod")

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # one worker a core; children inherit it
    os.environ.setdefault(name, "1")

LONGEST_FIRST = ("real time", "tests/end_to_end/", "tests/unit/diagnose/", "tests/contract/", "tests/")
MOST_WORKERS = 5


def pytest_xdist_auto_num_workers():
    """One worker a core, and one that mostly waits, for the real-time tests."""
    return min(len(os.sched_getaffinity(0)) + 1, MOST_WORKERS)


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items):
    """Put every test into its group, and the groups that take longest first."""
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            real_time = item.get_closest_marker("real_time") is not None
            item.add_marker(pytest.mark.xdist_group("real time" if real_time else item.nodeid.partition("::")[0]))
    items.sort(key=_rank)


def _rank(item):
    group = item.get_closest_marker("xdist_group").args[0]
    return next(rank for rank, start in enumerate(LONGEST_FIRST) if group.startswith(start))
