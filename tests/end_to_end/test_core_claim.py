"""The core claim: an effect that a bench has gained is named alone, measured, and modelled down to the noise.

The bench is the physics of `firmware_sim`, which shares no formula with `piezod`. Each effect belongs to another part
of the chain. The recordings are short and noisy, 0.3 % of the range, so that all of this runs in CI.
"""

import numpy as np
import pytest

import piezod
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.excitation import varying_triangles
from piezod.recording import write_csv
from tests.studies.mixed_work import mixed_work

RATE_HZ = 200.0
PEAK_V = 140.0
WORK_PEAK_V = 130.0  # within the range of the identification
WORK_S = 12.0
NOISE_N = 1.0
SEED = 1

GIVEN = {
    # amplifier: a step of 100 V lasts 50 samples, and half a sample is 1 %
    "slew_limit": ("limit_V_per_s", 400.0, 0.01),
    # stack: 12 s show two of the four decades of creep; an end that is wrong by a third of a decade is 15 %
    "creep": ("per_decade", 0.03, 0.15),
    # mechanics: a step rings for three periods, and a phase that is wrong by 1/30 period is 1 %
    "resonance": ("frequency_Hz", 25.0, 0.01),
    # load cell: 2 % of the time constant change 150 N by 1 N within 12 s
    "charge_leakage": ("time_constant_s", 20.0, 0.02),
}
"""Parameter, value and tolerance [1] of each effect."""


def record(path, voltage_V, effects, seed):
    """Drive the bench from rest with voltages, shape (n,) [V], and write what it reads."""
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": NOISE_N}, "effects": effects})
    force_N = Bench(scenario, seed=seed).run(voltage_V, 1.0 / RATE_HZ)
    time_s = np.arange(force_N.size) / RATE_HZ
    write_csv(piezod.Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N}), path)
    return path


def error_of(model, path):
    """Rms of the measured minus the simulated force [N], without the mean: a tare is no error of a model."""
    recording = piezod.read_recording(path)
    return float(np.std(recording.channel("force_N") - piezod.simulate(recording, model).channel("force_N")))


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("claim")
    before = record(folder / "before.csv", varying_triangles(PEAK_V, 0.5, 10, RATE_HZ), {}, 10 * SEED + 1)
    piezod.identify(before, plays=10, dead_zones=3).model.save(folder / "model.yaml")
    return folder / "model.yaml"


@pytest.mark.parametrize("name", GIVEN)
def test_an_effect_of_the_bench_is_named_alone_measured_and_modelled(identified, tmp_path, name):
    parameter, value, within = GIVEN[name]
    effects = {name: {parameter: value}}
    work = record(tmp_path / "work.csv", mixed_work(SEED + 3, WORK_S, RATE_HZ, WORK_PEAK_V), effects, 10 * SEED + 2)
    later = record(tmp_path / "later.csv", mixed_work(SEED + 104, WORK_S, RATE_HZ, WORK_PEAK_V), effects, 10 * SEED + 5)
    diagnosed = piezod.diagnose(work, identified)
    assert (diagnosed.verdict, diagnosed.effects) == ("explained", (name,))
    found = diagnosed.findings["effects"][0]["parameters"][parameter]
    assert found["low"] < value < found["high"]
    assert found["value"] == pytest.approx(value, rel=within)
    diagnosed.model.save(tmp_path / "model.yaml")
    error = diagnosed.findings["fit"]["held_out"]
    assert error["before"] > 3.0 * NOISE_N
    assert error_of(tmp_path / "model.yaml", work) == pytest.approx(error["after"], rel=0.1)
    assert error_of(tmp_path / "model.yaml", later) == pytest.approx(error["after"], rel=0.1)
