"""Rows that are missing from a recording are gaps, and wild cells are left out: neither is a frozen sensor."""

import numpy as np
import pytest

import piezod
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.sources import read_source
from tests.benches.plain_stack import RATE_HZ, read, triangles

U = triangles([90, 50, 100, 70, 35])


@pytest.fixture(scope="module")
def model():
    voltage_V = triangles([100, 40, 80, 60, 100, 30])
    channels = {"voltage_V": voltage_V, "force_N": read(voltage_V, 1)}
    return piezod.identify(piezod.Recording(np.arange(voltage_V.size) / RATE_HZ, channels)).model


def ready(model, folder, there, force_N):
    path = folder / "work.csv"
    columns = np.column_stack((np.arange(U.size) / RATE_HZ, U, force_N))[there]
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    return prepared([read_source(path, "recording", ("voltage_V", "force_N"))], model)


@pytest.mark.parametrize(
    "missing",
    [[100, 300, 301, 700, 900, 1200, 1201, 1202, 1700], range(600, 613), [*range(500, 540), *range(900, 960)]],
)
def test_missing_rows_do_not_count_and_are_no_frozen_reading(model, tmp_path, missing):
    there = ~np.isin(np.arange(U.size), missing)
    (one,) = ready(model, tmp_path, there, read(U, 2))
    assert one.frozen == ()
    np.testing.assert_array_equal(one.counts, there)
    assert any(f"{len(missing)} of {U.size} samples are missing" in note for note in one.notes)


@pytest.mark.parametrize("value", [1e12, 5000.0])
def test_a_wild_cell_is_named_and_does_not_count(model, tmp_path, value):
    force_N = read(U, 2)
    force_N[1234] = value
    (one,) = ready(model, tmp_path, np.full(U.size, fill_value=True), force_N)
    assert one.frozen == ()
    np.testing.assert_array_equal(np.flatnonzero(~one.counts), [1234])
    assert any(f"row 1235 ({value:.6g} at 6.17 s)" in note for note in one.notes)
