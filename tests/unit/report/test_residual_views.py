"""Residuals over their drivers and over the command's past, and the figures of them."""

from dataclasses import replace

import numpy as np
from bokeh.models import BoxAnnotation

from piezod.diagnose.findings import Place
from piezod.report.diagnosis.figures.curves import time_figures
from piezod.report.diagnosis.figures.drivers import driver_figure
from piezod.report.diagnosis.residual.residuals import Residuals, recordings_of_places
from piezod.report.diagnosis.residual.views import memory, since_reversal, views
from tests.unit.report.example_diagnosis import DT_S, WHERE, series


def test_samples_since_a_reversal_count_from_its_extreme():
    u = np.concatenate((np.linspace(0, 10, 11), np.linspace(9, 2, 8), np.linspace(3, 6, 4)))
    since, level = since_reversal(u)
    np.testing.assert_array_equal(since[10:19], [10, 1, 2, 3, 4, 5, 6, 7, 8])
    assert (level[12], level[20]) == (10.0, 2.0)
    np.testing.assert_array_equal(since[19:], [1, 2, 3, 4])


def test_binned_means_separate_rising_from_falling():
    one = series("work.csv")
    lag = np.sign(np.cos(2 * np.pi * 0.5 * one.time_s))
    residuals = Residuals(
        replace(one, reading_N=2.0 * one.command_V + lag), 2.0 * one.command_V, 2.0 * one.command_V + lag
    )
    view = next(view for view in views([residuals], [(1, residuals)], ("V", "N")) if view.driver.name == "voltage_V")
    np.testing.assert_allclose(view.before.rising[1:-1], 1.0, atol=0.05)
    np.testing.assert_allclose(view.before.falling[1:-1], -1.0, atol=0.05)
    np.testing.assert_allclose(view.after.mean, 0.0, atol=1e-12)


def test_memory_has_its_peak_at_the_age_of_the_past():
    rng = np.random.default_rng(5)
    one = series("work.csv", seconds=60.0)
    u = np.repeat(rng.uniform(0, 100, one.time_s.size // 10), 10)
    faded = np.empty(u.size)
    state, keep = 0.0, np.exp(-DT_S / 0.5)
    for k, value in enumerate(u):
        state = value + keep * (state - value)
        faded[k] = state
    residuals = Residuals(replace(one, command_V=u, reading_N=faded, counts=np.ones(u.size, bool)), 0.0 * u, faded)
    found = memory([residuals])
    assert 0.25 < found.age_s[np.abs(found.before).argmax()] < 1.5
    assert np.abs(found.after).max() < 1e-6


def test_a_place_in_time_belongs_to_the_recording_with_the_largest_error_there():
    one, two = (Residuals(s, s.reading_N.copy(), s.reading_N) for s in (series("one.csv"), series("two.csv")))
    two.given[2000:3000] += 5.0
    place = Place("time_s", 4.0, 6.0)
    assert recordings_of_places([place, WHERE[0]], [one, two]) == {place: two}


def test_one_outlier_does_not_flatten_the_residual():
    one = series("work.csv")
    spike = one.reading_N.copy()
    spike[500] += 1000.0
    residuals = Residuals(replace(one, reading_N=spike), one.reading_N, one.reading_N + 0.1)
    residual = time_figures(residuals, 1000, [], ("V", "N"), "extended model")[0][1]
    assert -5.0 < residual.y_range.start < -0.1
    assert 0.0 < residual.y_range.end < 5.0


def test_a_place_wider_than_the_data_does_not_compress_the_curves():
    one = series("work.csv")
    residuals = Residuals(one, 1.9 * one.command_V, 2.0 * one.command_V)
    view = next(view for view in views([residuals], [(1, residuals)], ("V", "N")) if view.driver.name == "rate_V_per_s")
    plot = driver_figure(view, [Place("rate_V_per_s", 50.0, 1e5)], "N", "extended model")[0][0]
    boxes = [box for box in plot.select(BoxAnnotation) if box.hatch_pattern]
    assert boxes
    assert max(abs(edge) for box in boxes for edge in (box.left, box.right)) <= np.abs(view.x).max()
