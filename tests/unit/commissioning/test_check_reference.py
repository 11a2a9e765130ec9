"""The force and the voltage that a reference asks for, as `piezod check` prints them."""

import numpy as np
import pytest

from piezod.commissioning.check_reference import check_distances, check_reference
from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.reference import FileReference
from piezod.model import load_model

BENCH = shipped("bench.yaml")


def limited(**limits):
    bench = load_bench(BENCH)
    return bench.model_copy(update={"limits": bench.limits.model_copy(update=limits)})


def checks_of(folder, force_N, *, limits=None, **keys):
    rows = "".join(f"{k / 1000:.3f},{value:.9g}\n" for k, value in enumerate(force_N))
    (folder / "reference.csv").write_text(f"time_s,reference_N\n{rows}", encoding="utf-8")
    reference = FileReference(kind="file", path="reference.csv", **keys)
    bench = limited(**(limits or {})).model_copy(update={"reference": reference})
    return bench, list(check_reference(bench, load_model(shipped("model.yaml")), folder))


def test_a_ramp_is_described_by_range_ends_rate_and_duration(tmp_path):
    _, (force, _) = checks_of(tmp_path, np.linspace(100.0, 150.0, 501))
    assert force.found == "100 to 150 N, first 100, last 150, at most 100 N/s, 501 ticks, 0.501 s"
    assert force.level == "OK"


def test_the_planned_voltage_gives_the_force_in_the_model(tmp_path):
    force_N = np.concatenate([np.linspace(60.0, 200.0, 300), np.linspace(200.0, 120.0, 200)])
    _, (_, voltage) = checks_of(tmp_path, force_N)
    words = voltage.found.replace(",", "").split()
    last_V, highest_V = float(words[words.index("last") + 1]), float(words[2])
    plant = load_model(shipped("model.yaml")).operator()
    low_V = float(words[words.index("first") + 1])
    simulated = plant.run(np.concatenate([np.linspace(0, low_V, 5), np.linspace(low_V, highest_V, 50), [last_V]]))
    assert simulated[-1] == pytest.approx(120.0, abs=0.01)


def test_a_wrong_value_shows_in_the_largest_rate(tmp_path):
    force_N = np.full(100, 117.25)
    force_N[50] = 90.0
    _, (force, voltage) = checks_of(tmp_path, force_N)
    assert "90 to 117.25 N, first 117.25, last 117.25, at most 2.725e+04 N/s" in force.found
    assert voltage.level == "WARN"
    assert "limits.slew_V_per_s" in voltage.remedy


def test_a_voltage_beyond_the_limits_is_a_warning(tmp_path):
    bench, (force, voltage) = checks_of(tmp_path, np.linspace(100.0, 320.0, 900))
    assert (force.level, voltage.level) == ("WARN", "WARN")
    assert f"{bench.limits.voltage_max_V:g} V (limits)" in voltage.remedy


def test_a_wrong_file_is_a_failure_with_its_line(tmp_path):
    _, checks = checks_of(tmp_path, [100.0, np.nan])
    assert [check.level for check in checks] == ["FAIL"]
    assert "line 3: reference_N is 'nan'" in checks[0].found


def distances(**limits):
    return {check.name: check for check in check_distances(limited(**limits), load_model(shipped("model.yaml")))}


def numbers(check):
    """Way [V], way [N] and time [ms] of a check."""
    words = check.found.split()
    return [float(words[words.index(unit) - 1]) for unit in ("V", "N", "ms,")]


@pytest.mark.parametrize("deceleration_V_per_s2", [None, 2e5, 2e6])
def test_a_stop_and_a_trip_are_described_by_volts_newtons_and_time(deceleration_V_per_s2):
    checks = distances(deceleration_V_per_s2=deceleration_V_per_s2)
    braking_s = 4000.0 / deceleration_V_per_s2 if deceleration_V_per_s2 else 0.0
    braking_V = 0.5 * 4000.0 * braking_s
    for name, ticks, debounce in (("stop", 1, 0), ("trip", 2, 1)):
        way_V, way_N, time_ms = numbers(checks[name])
        assert checks[name].level == "OK"
        assert way_V == pytest.approx(4.0 * ticks + braking_V, rel=0.01)
        assert 1.0 < way_N / way_V < 4.0  # the shipped model has 360 N at 140 V
        fall_ms = (140.0 + 4.0 * ticks + braking_V) / 4.0
        assert time_ms == pytest.approx(ticks + debounce + fall_ms + 2e3 * braking_s, rel=0.01)


@pytest.mark.parametrize(
    "limits",
    [
        {"deceleration_V_per_s2": 2e4},  # 400 V
        {"deceleration_V_per_s2": 2e5, "force_trip_N": 60.0},  # 110 N
        {"slew_V_per_s": 4.0},  # 35 s
    ],
)
def test_a_stop_beyond_range_trip_or_time_fails(limits):
    checks = distances(**limits)
    assert {check.level for check in checks.values()} == {"FAIL"}
    assert "must be at most 140 V" in checks["stop"].found


def test_a_reference_that_trips_by_the_way_of_a_stop_fails(tmp_path):
    force_N = np.linspace(100.0, 290.0, 951)  # 200 N/s, and about 80 V/s
    levels = [
        checks_of(tmp_path, force_N, limits={"deceleration_V_per_s2": deceleration})[1][1].level
        for deceleration in (None, 1e5, 100.0)  # 80 N
    ]
    assert levels == ["OK", "OK", "FAIL"]
