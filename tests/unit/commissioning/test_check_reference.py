"""The force and the voltage that a reference asks for, as `piezod check` prints them."""

import numpy as np
import pytest

from piezod.commissioning.check_reference import check_reference
from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.reference import FileReference
from piezod.model import load_model

BENCH = shipped("bench.yaml")


def checks_of(folder, force_N, **keys):
    rows = "".join(f"{k / 1000:.3f},{value:.9g}\n" for k, value in enumerate(force_N))
    (folder / "reference.csv").write_text(f"time_s,reference_N\n{rows}", encoding="utf-8")
    reference = FileReference(kind="file", path="reference.csv", **keys)
    bench = load_bench(BENCH).model_copy(update={"reference": reference})
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
