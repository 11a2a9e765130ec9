"""The fit of simulated outputs as MATLAB's `compare` defines it, against the definition."""

import json

import numpy as np
import pytest

from piezod.errors import UsageError
from piezod.report.output_comparison import (
    compare_files,
    comparison_as_dict,
    comparison_text,
    write_comparison_page,
)
from tests.unit.report.driven_by_model import MODEL, write_measured_and_simulated


@pytest.fixture
def files(tmp_path):
    return write_measured_and_simulated(tmp_path)


def test_the_fit_is_that_of_matlabs_compare(files):
    measured, simulated, force, noise = files
    result = compare_files(measured, [simulated], [MODEL], None, 1.0)
    recorded, model = result.simulated
    y = (force + noise)[:2999]
    values = np.interp(np.arange(2999), np.arange(0, 3000, 2), force[:3000:2] + 1.0)
    fit = 100 * (1 - np.linalg.norm(y - values) / np.linalg.norm(y - y.mean()))
    assert recorded.agreement.nrmse_percent == pytest.approx(fit, abs=1e-4)
    assert recorded.agreement.samples == 2999
    assert model.agreement.rms == pytest.approx(0.5, rel=0.05)
    assert result.best is model
    assert comparison_text(result).splitlines()[-1].startswith("model fits with")
    assert json.loads(json.dumps(comparison_as_dict(result)))["compared"][1]["name"] == "model"


def test_two_files_of_the_same_name_are_named_with_their_folders(files, tmp_path):
    measured, simulated, _, _ = files
    twin = tmp_path / "twin" / simulated.name
    twin.parent.mkdir()
    twin.write_bytes(simulated.read_bytes())
    result = compare_files(measured, [simulated, twin], [MODEL], None, 1.0)
    assert [output.name for output in result.simulated] == [
        f"{tmp_path.name}/{simulated.stem}",
        f"twin/{simulated.stem}",
        "model",
    ]


def test_outputs_that_differ_are_not_compared(files):
    with pytest.raises(UsageError, match="outputs differ: displacement_um, force_N"):
        compare_files(files[0], [], [MODEL], "displacement_um", 1.0)
    with pytest.raises(UsageError, match="nothing to compare with"):
        compare_files(files[0], [], [], None, 1.0)


def test_the_page_shows_the_best_fit(files, tmp_path):
    measured, simulated, _, _ = files
    write_comparison_page(tmp_path / "comparison.html", compare_files(measured, [simulated], [MODEL], None, 1.0))
    assert "model fits with" in (tmp_path / "comparison.html").read_text(encoding="utf-8")
