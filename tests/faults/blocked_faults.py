"""Stops while a part of the daemon stands still, as rows of the fault list (`blocked_stops.py`)."""

import math

from tests.faults import blocked_stops
from tests.faults.bench_pool import Observation


def blocked(pool, fault, *, blockades, ways=blocked_stops.WAYS):
    """Stop a bench of its own in each way under each blockade; the observed time is the longest until rest."""
    tries = [blocked_stops.stop_once(blockade, way) for blockade in blockades for way in ways]
    longest_s = max(one.took_s for one in tries)
    late = [f"{one.blockade}, {one.way}: {one.took_s:.2f} s" for one in tries if one.took_s > one.limit_s]
    observed = Observation("none", text="; ".join(late), after_ms=1e3 * min(longest_s, 1e6))
    observed.figures = {"stops": len(tries), "late": len(late), "never": sum(math.isinf(one.took_s) for one in tries)}
    return observed


INJECTORS = {"blocked": blocked}
