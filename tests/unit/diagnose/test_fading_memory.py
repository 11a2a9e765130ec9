"""A stack whose memory fades with the way: named for what it is, whatever start was taken for it, and no friction."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.selection.search import search
from tests.unit.diagnose.residuals import mixed_work, noise, series, time
from tests.unit.diagnose.test_corners import many_plays

SAMPLES, RATE_HZ, NOISE_N = 12_000, 200.0, 0.2
MEMORY_N, WAY_V, EXPONENT = 6.0, 40.0, 1.5


def faded(u):
    """Bouc's and Wen's state with equal shares of both of its terms, in small steps of its equation, from rest at 0."""
    out, z, before = np.empty_like(u), 0.0, 0.0
    for k, now in enumerate(u):
        steps = 1 + int(abs(now - before) / (0.01 * WAY_V))
        way = (now - before) / steps / WAY_V
        for _ in range(steps):
            z += way * (1.0 - abs(z) ** EXPONENT * (0.5 * np.sign(z * way) + 0.5))
        out[k], before = z, now
    return out


@pytest.mark.slow
def test_memory_that_fades_is_no_friction_and_a_wrong_start_does_not_hide_it():
    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(7), []
    slow = 60.0 - 60.0 * np.cos(0.5 * seconds) * np.cos(0.031 * seconds)
    for role, drive in (("identification", slow), ("recording", mixed_work(seconds))):
        u = np.clip(drive - drive[0], 0.0, None)
        force_N = many_plays(u) + NOISE_N * noise(SAMPLES, 0.0, rng)
        if role == "recording":
            force_N += 0.2 * many_plays(u) - MEMORY_N * faded(u)
        made.append(series(seconds, u, force_N, NOISE_N, role=role))
    made[1] = replace(made[1], path_V=(60.0, 0.0))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 140.0), 216.0)
    found = search(chain, empty_point(chain, 1.8, 0.0), lambda *_: None)
    assert found.names == ("noncongruent_minor_loops",)
    assert found.chain.series[1].path_V == ()
    assert found.hypothesis.loss < 1.1
