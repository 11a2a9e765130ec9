"""Recordings as benches give them: another sign, a clipped reading, an output that shares its name with an input."""

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from piezod.errors import RecordingError
from piezod.estimation.recordings.preparation import evenly_spaced
from piezod.estimation.recordings.sources import read_source
from piezod.model import load_model
from tests.benches.plain_stack import NOISE_N, RATE_HZ, read, triangles, work

U, W = triangles([100, 40, 80, 60, 100, 30]), work(3, 10.0)


def saved(path, u, y, names="time_s,voltage_V,force_N"):
    np.savetxt(path, np.column_stack((np.arange(u.size) / RATE_HZ, u, y)), "%.6f", ",", header=names, comments="")
    return path


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A model file identified on triangles."""
    folder = tmp_path_factory.mktemp("everyday")
    path = folder / "model.yaml"
    piezod.identify(str(saved(folder / "identification.csv", U, read(U, 1)))).model.save(path)
    return path


def diagnosed(recording, model, out):
    return diagnose_files([recording], model, out, None, None, lambda *_: None).findings


@pytest.mark.parametrize("gain", [-1.0, -0.3])
def test_a_reading_of_the_other_sign_is_refused_before_the_search(tmp_path, given, gain):
    path = saved(tmp_path / "work.csv", W, gain * read(W, 2))
    with pytest.raises(RecordingError, match="force_N falls where voltage_V rises, in the model it rises: turn the"):
        diagnosed(path, given, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_bench_that_always_reads_the_negative_matches_its_model(tmp_path):
    identification = saved(tmp_path / "identification.csv", U, -read(U, 1))
    model = tmp_path / "model.yaml"
    piezod.identify(str(identification)).model.save(model)
    assert load_model(model).output.channel == "-force_N"
    findings = diagnosed(saved(tmp_path / "work.csv", W, -read(W, 2)), model, tmp_path / "out")
    assert findings.verdict == "matches"
    assert findings.before == pytest.approx(NOISE_N, rel=0.15)


@pytest.mark.parametrize(("low_N", "high_N"), [(-np.inf, 50.0), (25.0, np.inf), (20.0, 60.0)])
def test_a_reading_at_the_end_of_its_range_is_clipped_and_no_effect(tmp_path, given, low_N, high_N):
    path = saved(tmp_path / "work.csv", W, np.clip(read(W, 2), low_N, high_N))
    findings = diagnosed(path, given, tmp_path / "out")
    assert (findings.verdict, findings.effects) == ("matches", ())
    limits = [limit for limit in (low_N, high_N) if np.isfinite(limit)]
    for limit in limits:
        assert any(f"clipped at {limit:g} N" in note for note in findings.notes)
    assert len(findings.recordings[-1]["left_out_s"]) >= len(limits)


@pytest.mark.parametrize("name", ["temperature_C", "temperature_degC"])
def test_an_output_is_no_input_whatever_its_name(tmp_path, name):
    names = f"time_s,voltage_V,{name}"
    model = tmp_path / "model.yaml"
    first = saved(tmp_path / "identification.csv", U, read(U, 1), names)
    piezod.identify(str(first), output=name).model.save(model)
    late = np.concatenate((np.full(20, read(W, 2)[0]), read(W, 2)[:-20]))
    findings = diagnosed(saved(tmp_path / "work.csv", W, late, names), model, tmp_path / "out")
    assert "thermal_drift" not in [one.name for one in findings.effects]
    assert "transport_delay" in [one.name for one in findings.effects]


@pytest.mark.parametrize("copy", ["voltage_V", "force_N"])
def test_a_copy_of_a_column_is_no_temperature(tmp_path, given, copy):
    model, y = load_model(given), read(W, 2)
    columns = np.column_stack((np.arange(W.size) / RATE_HZ, W, y, 20.0 + 0.1 * (W if copy == "voltage_V" else y)))
    path = tmp_path / "work.csv"
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N,temperature_C", comments="")
    source = read_source(path, "recording", (model.input.channel, model.output.channel))
    series = evenly_spaced(source, model)
    assert series.temperature_C is None
    assert any(f"temperature_C is a copy of {copy}, no temperature" in note for note in series.notes)
