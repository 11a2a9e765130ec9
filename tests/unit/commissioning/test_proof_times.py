"""Times of a proof test: rows are whole ticks with the jitter of their wake-ups."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from piezod.commissioning.proof import STEPS
from piezod.commissioning.proof.bench import ProofBench, Run
from piezod.config import load_bench
from piezod.control import Cause, State

BENCH = load_bench(Path(__file__).parents[3] / "config" / "bench.yaml")
ROW = [("time_ns", "i8"), ("state", "i4"), ("force_N", "f8")]


def result_of_step(name, ticks, jitter):
    """Result of the step whose trip acts this many ticks after the first force beyond its limit."""
    times = np.arange(ticks + 2) * BENCH.dt_s
    times[-1] += jitter * BENCH.dt_s
    rows = np.zeros(times.size, ROW)
    rows["time_ns"] = np.rint(1e9 * times)
    rows["force_N"] = 10.0 if name == "minimum" else 0.0
    rows["force_N"][1:] = 0.0 if name == "minimum" else 10.0
    rows["state"] = State.RUNNING
    rows["state"][-1] = State.RAMP_DOWN
    run = Run(rows, Cause.UNDER_FORCE if name == "minimum" else Cause.OVER_FORCE)
    proof = SimpleNamespace(bench=BENCH, rest_N=0.0, level_N=10.0, hold_level=lambda tightened: run)
    proof.reaction_ms = lambda samples: ProofBench.reaction_ms(proof, samples)
    return STEPS[name](proof).result


@pytest.mark.parametrize("name", ["force", "minimum"])
@pytest.mark.parametrize("jitter", [-0.3, 0.0, 0.003, 0.3])
def test_the_last_allowed_tick_passes_whatever_its_jitter_and_the_next_one_fails(name, jitter):
    allowed = BENCH.limits.force_debounce_samples + 2
    assert result_of_step(name, allowed, jitter) == "pass"
    assert result_of_step(name, allowed + 1, jitter) == "fail"
