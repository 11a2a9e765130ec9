"""One fit against the length of the recording and the number of plays: time, and deviation from linear growth."""

import resource
from collections.abc import Iterator
from time import perf_counter

import numpy as np

from piezod.estimation.base.thresholds import dead_zone_thresholds, play_thresholds
from piezod.estimation.fit.columns import Samples, Structure
from piezod.excitation import varying_triangles
from piezod.identify.fit import fit_hysteresis
from piezod.operators import PrandtlIshlinskii
from tests.benchmarks.table import Row

MOST_MILLION_S = 2.0
MOST_MEMORY_MIB = 1536.0
U_MAX, Y_MAX = 140.0, 300.0


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows by samples at n = 20, m = 4, then by plays at 10^6 (quick: 10^5) samples."""
    lengths = (10**4, 10**5) if quick else (10**4, 10**5, 10**6, 10**7)
    before_s = None
    _fit_s(10**4, 20, 4)  # compiled and cached
    for samples in lengths:
        duration_s = _fit_s(samples, 20, 4)
        limit = None if before_s is None else 10 * before_s
        most = MOST_MILLION_S if samples == 10**6 else None
        what = f"{samples:.0e} samples, 20 plays, 4 dead zones"
        yield Row("identify", what, "s", duration_s, limit, "ten times a tenth of the samples", most=most)
        before_s = duration_s
    resident_MiB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    yield Row(
        "identify", f"largest resident memory, {lengths[-1]:.0e} samples", "MiB", resident_MiB, most=MOST_MEMORY_MIB
    )
    samples = lengths[1] if quick else 10**6
    first_s = None
    for plays in (5, 10, 20, 40):
        duration_s = _fit_s(samples, plays, 4)
        limit = None if first_s is None else first_s * plays / 5
        yield Row(
            "identify", f"{samples:.0e} samples, {plays} plays", "s", duration_s, limit, "in proportion to 5 plays"
        )
        first_s = first_s or duration_s


def _fit_s(samples: int, plays: int, zones: int) -> float:
    """One fit of a known model with a tenth of a percent of noise."""
    rng = np.random.default_rng(1)
    thresholds = play_thresholds(plays, 0.5 * U_MAX)
    weights = np.concatenate(([0.5], np.full(plays, 0.5 / plays)))
    plant = PrandtlIshlinskii(thresholds, weights, [0.0, 60.0], [2.0, 0.3])
    u = varying_triangles(U_MAX, 1.0, 41, samples / 41.0)[:samples]
    y = plant.run(u) + rng.normal(0.0, 0.3, u.size)
    structure = Structure(thresholds, dead_zone_thresholds(zones, 0.0, float(y.max())), 0.0, U_MAX, U_MAX / Y_MAX)
    recording = [Samples(u, y, np.ones(u.size, bool))]
    begun = perf_counter()
    fit_hysteresis(structure, recording)
    return perf_counter() - begun
