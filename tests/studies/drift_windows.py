"""The rank test of the drift watch, compiled, for thousands of days; it has the alarms of `DriftAlarm`."""

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.daemon.drift.alarm import CLASSES, ROUNDING, STAKE
from piezod.daemon.drift.reference import DELAY, FEWEST, STEP, STEPS

Array = NDArray[np.float64]


@numba.njit(cache=False)
def alarms_at(
    distance: Array, kind: NDArray[np.int64], kinds: int, level: float, tolerance: float
) -> list[int]:  # pragma: no cover - compiled
    """Places of the alarms; distances over the model's own error, and kind of each window, shape (N,)."""
    counts = np.zeros((kinds, 2 * STEPS + 1), np.int64)
    waiting_kind, waiting_step = np.zeros(DELAY, np.int64), np.zeros(DELAY, np.int64)
    waits, evidence, places = 0, 0.0, [0 for _ in range(0)]
    for k in range(distance.size):
        cell, alarm = kind[k], False
        step = min(max(int(np.floor(np.log(distance[k]) / STEP)) + STEPS, 0), 2 * STEPS)
        if counts[cell, 0] >= FEWEST:
            ranks = counts[cell, 0] + 1
            lowered = min(max(int(np.floor(np.log(distance[k] / (1.0 + tolerance)) / STEP)) + STEPS, 0), 2 * STEPS)
            classes = min(ranks, CLASSES)
            outcome = counts[cell, lowered] * classes // ranks
            ends = np.empty(classes + 1)
            for j in range(classes + 1):
                ends[j] = -(-j * ranks // classes) / ranks
                if j > outcome and level / (1.0 + evidence) >= (ends[1] ** STAKE) / ends[1]:
                    break
            payoff = (ends[outcome + 1] ** STAKE - ends[outcome] ** STAKE) / (ends[outcome + 1] - ends[outcome])
            most = max(level / (1.0 + evidence), 1.0)
            if ends[1] ** STAKE / ends[1] > most:
                for cut in range(1, classes):
                    raised = (1.0 - most * ends[cut]) / (1.0 - ends[cut] ** STAKE)
                    paid = (ends[cut + 1] ** STAKE - ends[cut] ** STAKE) / (ends[cut + 1] - ends[cut])
                    if raised * paid <= most:
                        payoff = most if outcome < cut else min(raised * payoff, most)
                        break
            evidence = (1.0 + evidence) * payoff
            alarm = evidence >= level * (1.0 - ROUNDING)
        if alarm:
            evidence, waits = 0.0, 0
            places.append(k)
            continue
        if waits == DELAY:
            counts[waiting_kind[0], : waiting_step[0] + 1] += 1
            waiting_kind[:-1], waiting_step[:-1] = waiting_kind[1:].copy(), waiting_step[1:].copy()
            waits -= 1
        waiting_kind[waits], waiting_step[waits] = cell, step
        waits += 1
    return places
