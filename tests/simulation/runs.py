"""Histories in processes of their own: a fork has every module loaded, and ends without a trace."""

import faulthandler
import gc
import logging
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from tests.simulation.amplifier import JudgedBench
from tests.simulation.history import BENCH, History
from tests.simulation.machine import BOOTED_NS

MEMORY = Path("/dev/shm")


@dataclass
class Result:
    """Result of one history."""

    seed: int
    digest: str = ""
    violations: list = field(default_factory=list)
    seconds: float = 0.0
    real_s: float = 0.0
    events: int = 0
    ticks: int = 0
    log: list = field(default_factory=list)
    observed: dict = field(default_factory=dict)


def warm_up():
    """Load what every history needs, before the first fork."""
    import piezod.bridge
    import piezod.daemon.drift
    import piezod.daemon.service
    import piezod.session.control_process
    import piezod.session.learned_file  # noqa: F401
    from piezod.model import make_compensator
    from piezod.session.assembly import load_bench_and_model

    bench, model = load_bench_and_model(BENCH)
    compensator = make_compensator(bench.compensation, model, bench.dt_s, bench.compensation_without)
    compensator.commit(compensator.plan(0.0))
    device = JudgedBench("stack", seed=1)
    device.judge_by(0.0, 140.0, 800.0, 0.005)
    device.advance_steps(1)
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # the device drops garbled frames, and says so
    gc.collect()
    gc.freeze()  # a collection in the fork would copy every page


def run_here(plan, trace=None, make=History):
    """Run a history in this process, which must not be used afterwards."""
    begun_s = time.process_time()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # so that asyncio does not set its own
    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp(prefix="piezod-simulation-", dir=MEMORY))
    try:
        history = make(plan, folder, trace)
        violations = history.run()
        machine = history.machine
        return Result(
            plan.seed,
            machine.digest.hexdigest()[:16],
            violations,
            1e-9 * (machine.now_ns - BOOTED_NS),
            time.process_time() - begun_s,
            machine.events,
            history.amplifier.device.commands,
            [f"{process.name}: {line}" for process in machine.processes for line in process.log],
            getattr(history, "observed", {}),
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run(plan, trace=None, within_s=60.0, make=History):
    """Run a history in a fork."""
    reader, writer = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        os.close(reader)
        gc.disable()
        faulthandler.dump_traceback_later(within_s, exit=True)
        code, sys.stderr = 0, sys.__stderr__  # a test replaces it, and piezod asks for its descriptor
        try:
            result = run_here(plan, trace, make)
        except BaseException:  # noqa: BLE001  # the parent reports it
            result = Result(plan.seed, violations=[("crash", 0.0, traceback.format_exc())])
            code = 1
        with os.fdopen(writer, "wb") as out:
            pickle.dump(result, out)
        sys.stdout.flush()
        os._exit(code)
    os.close(writer)
    with os.fdopen(reader, "rb") as source:
        content = source.read()
    os.waitpid(pid, 0)
    if not content:
        return Result(plan.seed, violations=[("hang", 0.0, f"not over after {within_s:g} s")])
    return pickle.loads(content)
