"""Recordings of the emulated bench with an effect switched on, diagnosed as commands: named, measured, modelled."""

import json

import numpy as np
import pytest

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.excitation import varying_triangles
from piezod.model import load_model
from piezod.recording import Recording, write_csv
from piezod.recording.hold import HELD_ONE_SAMPLE
from tests.benches.emulator import piezod

RATE_HZ = 500.0
PEAK_V = 140.0
NOISE_N = 0.1


def mixed_work(seed, duration_s=30.0):
    """Sines, triangles, steps, holds and ramps, in an order drawn from a seed."""
    rng = np.random.default_rng(seed)
    parts = [np.zeros(50)]
    while sum(map(len, parts)) < duration_s * RATE_HZ:
        time_s = np.arange(int(rng.uniform(1.5, 3.0) * RATE_HZ)) / RATE_HZ
        reach, kind = rng.uniform(0.1, 0.45) * PEAK_V, rng.integers(4)
        middle = rng.uniform(reach, PEAK_V - reach)
        phase = 10 ** rng.uniform(-0.3, 1.0) * time_s
        shapes = (
            middle - reach * np.cos(2 * np.pi * phase),
            middle + reach * (4 * np.abs(phase % 1 - 0.5) - 1),
            np.repeat(rng.uniform(0.05, 0.95, 5) * PEAK_V, time_s.size // 5),
            np.interp(time_s, np.linspace(0, time_s[-1], 6), rng.uniform(0.02, 0.98, 6) * PEAK_V),
        )
        way = np.linspace(parts[-1][-1], shapes[kind][0], 100)
        parts += [way, shapes[kind]]
    return np.concatenate(parts)[: int(duration_s * RATE_HZ)]


def record(path, voltage_V, effects, seed, *, rows_of_ring_log=False):
    """`rows_of_ring_log`: beside each command what it led to, as `piezod record` has it, and not what was before it."""
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": NOISE_N}, "effects": effects})
    force_N = Bench(scenario, seed=seed).run(voltage_V, 1.0 / RATE_HZ)
    columns, said = {"voltage_V": voltage_V, "force_N": force_N}, {}
    if rows_of_ring_log:
        columns, said = {"voltage_V": voltage_V[:-1], "force_N": force_N[1:]}, HELD_ONE_SAMPLE.metadata
    write_csv(Recording(np.arange(columns["force_N"].size) / RATE_HZ, columns, said), path)


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("diagnose")
    record(folder / "identification.csv", varying_triangles(PEAK_V, 0.25, 11, RATE_HZ), {}, 1)
    done = piezod(
        "identify", folder / "identification.csv", "-o", folder / "model.yaml", "--plays", 14, "--dead-zones", 6
    )
    assert done.returncode == 0, done.stderr
    return folder


def diagnosed(folder, tmp_path, effects, **how):
    record(tmp_path / "work.csv", mixed_work(3), effects, 2, **how)
    record(tmp_path / "later.csv", mixed_work(4), effects, 5)
    out = tmp_path / "out"
    done = piezod("diagnose", tmp_path / "work.csv", "--model", folder / "model.yaml", "-o", out, "--json", timeout=400)
    assert done.returncode == 0, done.stderr
    findings = json.loads((out / "findings.json").read_text(encoding="utf-8"))
    printed = json.loads(done.stdout)
    assert printed.pop("next_step")["words"]
    assert findings == printed
    return findings


@pytest.mark.slow
def test_a_delay_counts_from_its_command_where_the_recording_says_how_long_that_was_held(identified, tmp_path):
    effects = {"electrical_lag": {"time_constant_s": 0.008}, "transport_delay": {"delay_s": 0.0105}}
    findings = diagnosed(identified, tmp_path, effects, rows_of_ring_log=True)
    found = {one["name"]: one["parameters"] for one in findings["effects"]}
    assert set(found) == set(effects)
    assert found["transport_delay"]["delay_s"]["value"] == pytest.approx(0.0105, rel=0.05)
    assert load_model(tmp_path / "out" / "model.yaml").read_after == 1.0


@pytest.mark.slow
def test_no_recording_of_held_commands_tells_a_delay_better_than_to_a_sample(identified, tmp_path):
    findings = diagnosed(identified, tmp_path, {"transport_delay": {"delay_s": 0.0105}})
    assert [one["name"] for one in findings["effects"]] == ["transport_delay"]
    delay_s = findings["effects"][0]["parameters"]["delay_s"]
    assert delay_s["low"] < 0.0105 < delay_s["high"] < delay_s["low"] + 4.0 / RATE_HZ


def held_out_rms(tmp_path, model):
    done = piezod(
        "simulate", tmp_path / "later.csv", "--model", model, "-o", tmp_path / "simulated.csv", "--json", "--force"
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["compared"]["rms"]


def test_a_bench_with_nothing_wrong_matches_its_model(identified, tmp_path):
    findings = diagnosed(identified, tmp_path, {})
    assert findings["verdict"] == "matches"
    assert findings["effects"] == []
    assert findings["noise_floor"]["value"] == pytest.approx(NOISE_N, rel=0.1)
    assert load_model(tmp_path / "out" / "model.yaml").effects == ()
    assert held_out_rms(tmp_path, tmp_path / "out" / "model.yaml") < 1.1 * NOISE_N


@pytest.mark.parametrize(
    ("name", "parameter", "within"),
    [
        pytest.param("electrical_lag", "time_constant_s", 0.02, marks=pytest.mark.slow),
        pytest.param("creep", "per_decade", 0.25, marks=pytest.mark.slow),
        pytest.param("resonance", "frequency_Hz", 0.005, marks=pytest.mark.slow),
    ],
)
def test_an_effect_that_has_come_since_is_named_measured_and_modelled(identified, tmp_path, name, parameter, within):
    given = {"electrical_lag": 0.008, "creep": 0.015, "resonance": 45.0}[name]
    findings = diagnosed(identified, tmp_path, {name: {parameter: given}})
    assert findings["verdict"] == "explained"
    assert [one["name"] for one in findings["effects"]] == [name]
    assert findings["effects"][0]["parameters"][parameter]["value"] == pytest.approx(given, rel=within)
    assert findings["fit"]["held_out"]["gap_closed"] > 0.95
    before = held_out_rms(tmp_path, identified / "model.yaml")
    after = held_out_rms(tmp_path, tmp_path / "out" / "model.yaml")
    assert before > 3 * NOISE_N
    assert (before**2 - after**2) / (before**2 - NOISE_N**2) > 0.98  # of the gap, nothing fitted
