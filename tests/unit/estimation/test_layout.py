"""A file that does not say everything itself is read again as it was read for the model."""

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.estimation.recordings.intake import load_recordings
from piezod.estimation.recordings.layout import layout_of
from piezod.model import load_model
from piezod.recording import TextOptions
from tests.benches.plain_stack import RATE_HZ, read, triangles
from tests.faults.bench_pool import run_piezod

U = triangles([100, 40, 80, 60, 100, 30])
PLAIN = ["--rate-Hz", "200"]
BARE = [*PLAIN, "--columns", "voltage_V,force_N", "--decimal", ","]
TIMED = ["--columns", "time_s,voltage_V,force_N"]


def write(path, options):
    columns = [U, read(U, 1)] if options is not TIMED else [np.arange(U.size) / RATE_HZ, U, read(U, 1)]
    header = "" if "--columns" in options else "voltage_V,force_N"
    np.savetxt(path, np.column_stack(columns), "%.6f", ",", header=header, comments="")
    if "--decimal" in options:
        path.write_text(path.read_text().replace(",", ";").replace(".", ","))


@pytest.mark.parametrize("options", [PLAIN, BARE, TIMED], ids=["no time", "no header", "no header but time"])
def test_text_options_of_the_identification_are_used_again(tmp_path, options):
    for name in ("first.csv", "second.csv"):
        write(tmp_path / name, options)
    model = tmp_path / "model.yaml"
    assert run_piezod("identify", tmp_path / "first.csv", *options, "-o", model)[0] == 0
    told = layout_of(tmp_path / "second.csv", load_model(model), TextOptions())
    loaded = load_recordings([tmp_path / "second.csv"], "voltage_V", "force_N", text=told)[0]
    np.testing.assert_allclose(loaded.recording.channel("voltage_V"), U, atol=1e-6)
    assert np.diff(loaded.recording.time_s)[0] == pytest.approx(1.0 / RATE_HZ)
    simulated = tmp_path / "simulated.csv"
    assert run_piezod("simulate", tmp_path / "second.csv", "--model", model, "-o", simulated)[0] == 0


def test_a_file_of_another_layout_is_refused_in_its_own_words(tmp_path):
    write(tmp_path / "first.csv", PLAIN)
    model = tmp_path / "model.yaml"
    assert run_piezod("identify", tmp_path / "first.csv", *PLAIN, "-o", model)[0] == 0
    (tmp_path / "other.csv").write_text("no numbers here\n" * 30)
    with pytest.raises(RecordingError):
        layout_of(tmp_path / "other.csv", load_model(model), TextOptions())


def test_a_scale_of_the_identification_is_used_again(tmp_path):
    """Without it the second file would be read in volts of the monitor, a tenth of the command."""
    scale = ["--scale", "voltage_V=10 V/V", "--scale", "cell_V=100 N/V"]
    table = np.column_stack([np.arange(U.size) / RATE_HZ, U / 10.0, read(U, 1) / 100.0])
    for name in ("first.csv", "second.csv"):
        np.savetxt(tmp_path / name, table, "%.8f", ",", header="time_s,voltage_V,cell_V", comments="")
    model, simulated = tmp_path / "model.yaml", tmp_path / "simulated.csv"
    named = ["--input", "voltage_V", "--output", "cell_N"]
    assert run_piezod("identify", tmp_path / "first.csv", *scale, *named, "-o", model)[0] == 0
    told = layout_of(tmp_path / "second.csv", load_model(model), TextOptions())
    assert told is not None
    assert told.scale == ("voltage_V=10 V/V", "cell_V=100 N/V")
    loaded = load_recordings([tmp_path / "second.csv"], "voltage_V", "cell_N", text=told)[0]
    np.testing.assert_allclose(loaded.recording.channel("voltage_V"), U, atol=1e-6)
    assert run_piezod("simulate", tmp_path / "second.csv", "--model", model, "-o", simulated)[0] == 0
