"""Compile modules and functions of both packages, so that the processes of a test run load them from their caches.

    python -m tests.compile_functions

numba compiles a function when it is first called, and stores it beside its source. Processes that begin with an empty
cache compile the same functions at the same time. Python itself stores no module where PYTHONDONTWRITEBYTECODE is set.
"""

import compileall
import tempfile
import time
from pathlib import Path

import numpy as np

from firmware_sim.concealed.study.make import make
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.diagnose.command import diagnose_files
from piezod.estimation.recordings.intake import load_recordings
from piezod.excitation import varying_triangles
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.model import save_model
from piezod.recording import Recording, write_csv
from tests.simulation.runs import warm_up

ROOT = Path(__file__).parents[1]
RATE_HZ, PEAK_V = 200.0, 130.0
EFFECTS = {"electrical_lag": {"time_constant_s": 0.02}, "creep": {"per_decade": 0.02}}
STUDY_SEED, STUDY_CASES = 13, 4


def record(path, voltage_V, effects):
    """Write a recording of the emulated bench."""
    bench = Bench(load_scenario("stack", {"effects": effects}), seed=1)
    force_N = bench.run(voltage_V, 1.0 / RATE_HZ)
    write_csv(Recording(np.arange(voltage_V.size) / RATE_HZ, {"voltage_V": voltage_V, "force_N": force_N}), path)


def main():
    """Identify a bench, diagnose a changed one, make a small concealed study, and drive one step with a judge."""
    begun_s = time.monotonic()
    for package in ("piezod", "firmware_sim"):
        compileall.compile_dir(ROOT / package, quiet=1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        voltage_V = varying_triangles(PEAK_V, 1.0, 11, RATE_HZ)
        record(folder / "identification.csv", voltage_V, {})
        record(folder / "work.csv", voltage_V, EFFECTS)
        taken = load_recordings([folder / "identification.csv"], "voltage_V", "force_N", lambda *_: None)
        recordings, sources = [one.recording for one in taken], [one.source for one in taken]
        identified = identify(recordings, Options(plays=8, zones=3), "compiled", sources=sources)
        save_model(identified.model, folder / "model.yaml")
        diagnose_files([folder / "work.csv"], folder / "model.yaml", folder / "out", None, None, lambda *_: None)
        make(folder / "study", STUDY_CASES, seed=STUDY_SEED)
    warm_up()
    print(f"compiled in {time.monotonic() - begun_s:.0f} s")


if __name__ == "__main__":
    main()
