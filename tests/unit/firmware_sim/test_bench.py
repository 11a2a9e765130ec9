import os

import numpy as np
import pytest

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.compiled_cache import remove_older_than_sources
from firmware_sim.physics.scenario import scenario_names
from tests.unit.firmware_sim.waves import bench, forces, opening_percent, triangles


def test_the_stack_loop_is_ten_to_fifteen_percent_of_range():
    drive_V = triangles([140.0] * 2)
    force_N = Bench("stack", seed=2).run(drive_V, 1e-3)
    assert 10.0 < opening_percent(drive_V[10_000:], force_N[10_000:]) < 15.0
    assert 290.0 < force_N.max() < 310.0


def test_the_seed_bench_opens_as_the_thesis_measured():
    full_V = triangles([140.0] * 3)
    force_N = Bench("seed_bench", seed=2).run(full_V, 1e-3)
    assert opening_percent(full_V[10_000:], force_N[10_000:]) == pytest.approx(5.5, abs=0.2)
    varying_V = triangles(np.array([0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2]) * 140.0)
    force_N = Bench("seed_bench", seed=2).run(varying_V, 1e-3)
    assert opening_percent(varying_V, force_N) == pytest.approx(6.17, abs=0.2)


def test_force_remains_after_the_first_cycle():
    force_N = forces(triangles([140.0]))
    assert force_N[-1] > 0.05 * force_N.max()


def test_the_force_law_bends_the_middle_of_the_loop():
    drive_V = triangles([140.0] * 2)
    force_N = forces(drive_V)
    rising, falling = force_N[10_000:15_000], force_N[15_000:20_000][::-1]
    middle = 0.5 * (rising + falling)
    assert middle[2500] - 0.5 * (middle[0] + middle[-1]) > 0.02 * np.ptp(force_N)


def test_the_noise_has_the_stated_size():
    force_N = forces(np.zeros(20_000), noise_N=0.1)
    assert np.std(force_N) == pytest.approx(0.1, rel=0.03)
    assert abs(np.corrcoef(force_N[:-1], force_N[1:])[0, 1]) < 0.03


def test_coloured_noise_has_the_stated_size_and_memory():
    device = bench(load_cell={"coloured_noise_N": 0.5, "coloured_corner_Hz": 5.0})
    force_N = device.run(np.zeros(60_000), 1e-3)
    assert np.std(force_N) == pytest.approx(0.5, rel=0.15)
    lag_one = np.corrcoef(force_N[:-1], force_N[1:])[0, 1]
    assert lag_one == pytest.approx(np.exp(-2 * np.pi * 5.0 * 1e-3), abs=0.01)


def test_one_seed_gives_one_record_and_another_another():
    drive_V = triangles([100.0], period_s=1.0)
    first, again, other = (forces(drive_V, seed=seed, noise_N=0.1) for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_advancing_by_hand_agrees_with_the_fast_path():
    drive_V = triangles([120.0], period_s=0.5)
    device = bench(noise_N=0.1)
    by_hand = []
    for voltage_V in drive_V:
        by_hand.append(device.sample().force_N)
        device.set_voltage(voltage_V)
        device.advance(1e-3)
    assert np.array_equal(by_hand, forces(drive_V, noise_N=0.1))


def test_durations_that_are_no_whole_steps_add_up():
    device = bench()
    for _ in range(1000):
        device.advance(0.33e-4)
    assert device.time_s == pytest.approx(0.033, abs=1e-4)


def test_the_heartbeat_counts_device_samples_and_wraps():
    device = bench()
    device.advance(1.0)
    assert device.sample().heartbeat == 4000
    device.advance(20.0)
    assert device.sample().heartbeat == (21 * 4000) % 65536


def test_a_sample_between_two_physics_steps_is_taken_at_its_own_time():
    drive_V = np.linspace(0.0, 140.0, 4001)
    every_step = bench(sample_rate_Hz=10_000.0).run(drive_V, 1e-4, interpolate=True)
    third_ms = bench(sample_rate_Hz=3000.0).run(drive_V, 1e-4, interpolate=True)
    time_s = np.arange(drive_V.size) * 1e-4
    sampled_s = np.floor(time_s * 3000.0 + 1e-6) / 3000.0
    np.testing.assert_allclose(third_ms, np.interp(sampled_s, time_s, every_step), atol=1e-6)


def test_the_force_hardly_depends_on_the_physics_step():
    drive_V = triangles([130.0, 60.0], period_s=2.0)
    effects = {"resonance": {"frequency_Hz": 60.0}, "electrical_lag": True, "friction": True, "creep": True}
    on = {name: {} if value is True else value for name, value in effects.items()}
    coarse = bench(effects=on, step_s=1e-4).run(drive_V, 1e-3)
    fine = bench(effects=on, step_s=2e-5).run(drive_V, 1e-3)
    assert np.max(np.abs(coarse - fine)) < 0.05


def test_the_true_force_has_no_noise_and_the_reading_has():
    device = bench(noise_N=0.5)
    device.set_voltage(80.0)
    device.advance(0.1)
    before_N = device.true_force_N
    readings = set()
    for _ in range(5):
        device.advance(1e-3)
        readings.add(device.sample().force_N)
        assert device.true_force_N == before_N
    assert len(readings) == 5


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_runs_and_rests_at_zero(name):
    device = Bench(name, seed=1)
    device.advance(0.5)
    assert abs(device.sample().force_N) < 1.0
    assert device.sample().status == 1


def test_a_compiled_loop_does_not_outlive_an_edit_of_what_it_calls(tmp_path):
    source, outdated, fresh = tmp_path / "mechanics.py", tmp_path / "kernels.run.nbi", tmp_path / "kernels.advance.nbi"
    for path, modified_s in ((outdated, 100), (source, 200), (fresh, 300)):
        path.touch()
        os.utime(path, (modified_s, modified_s))
    remove_older_than_sources(tmp_path, tmp_path)
    assert not outdated.exists()
    assert fresh.exists()
