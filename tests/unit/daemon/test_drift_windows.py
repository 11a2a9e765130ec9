"""The compiled test of the study gives the alarms of the daemon's own."""

import numpy as np

from piezod.daemon.drift.alarm import DriftAlarm
from piezod.daemon.drift.reference import BlockReference
from tests.studies.drift_windows import alarms_at


def test_the_compiled_test_has_the_alarms_of_the_daemons_own():
    random, count, level, tolerance = np.random.default_rng(3), 6000, 300.0, 0.02
    distance, kind = np.exp(0.1 * random.standard_t(5, count)), random.integers(0, 3, count)
    reference, alarm, places = BlockReference((0.0, 140.0), 1.0, tolerance), DriftAlarm(level), []
    for k in range(count):
        cell = int(kind[k])
        if reference.is_known(cell) and alarm.add_rank(reference.rank(cell, distance[k]), reference.blocks_of(cell)):
            places.append(k)
            reference.forget_waiting()
        else:
            reference.add(cell, distance[k])
    assert len(places) > 5
    assert alarms_at(distance, kind, 3, level, tolerance) == places
