"""Faults between the daemon and its control process: late commands, a dead parent, and configurations read again."""

import contextlib
import time

import yaml

from piezod.errors import PiezodError
from tests.faults.bench_pool import Observation
from tests.faults.live_bench import ROOT, LiveBench
from tests.faults.running_faults import busy_machine


def armed_on_a_cold_cache(pool, fault, *, effect):
    """Start with an empty cache of compiled steps on a busy machine, and arm as soon as the daemon reports READY."""
    folder = pool.new_folder()
    model = yaml.safe_load((ROOT / "config" / "model.yaml").read_text(encoding="utf-8"))
    (folder / "model.yaml").write_text(yaml.safe_dump(model | {"effects": [effect]}), encoding="utf-8")
    bench = LiveBench(folder / "bench", changes={"model": str(folder / "model.yaml")})
    observed = Observation()
    try:
        with busy_machine():
            bench.environment = {"NUMBA_CACHE_DIR": str(folder)}
            ready_s = bench.start(within_s=120.0)  # the steps are compiled
            begun_s = time.monotonic()
            try:
                bench.send_command("arm")
            except PiezodError as error:
                observed.text = str(error)
        with contextlib.suppress(AssertionError):
            bench.wait_state("RUNNING", within_s=10.0)
        observed.after_ms = 1e3 * (time.monotonic() - begun_s)
        observed.state = bench.status()["state"]
        observed.figures = {"ready_s": ready_s}
        observed.text += bench.service.log()
        observed.armings = bench.rearms
    finally:
        bench.close()
    return observed


INJECTORS = {
    "armed_on_a_cold_cache": armed_on_a_cold_cache,
}
