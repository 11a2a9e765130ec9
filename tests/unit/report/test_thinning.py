"""Thinned curves keep spikes and gaps."""

import numpy as np

from piezod.report.figures.thinning import broken_at_gaps, envelope, envelope_times, extremes


def test_a_thinned_curve_keeps_every_spike():
    values = np.zeros(100_000)
    values[31_415], values[77_777] = 5.0, -3.0
    thin = envelope(values, 1000)
    assert thin.size <= 1002
    assert (thin.max(), thin.min()) == (5.0, -3.0)
    times = envelope_times(np.arange(100_000.0), 1000)
    assert times.size == thin.size
    assert abs(times[thin.argmax()] - 31_415) <= 200
    assert {31_415, 77_777} <= set(extremes(values, 1000))


def test_a_thinned_curve_keeps_gaps_and_short_curves_as_they_are():
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    thin = envelope(values, 100)
    assert np.isnan(thin[20:40]).all()
    assert np.isfinite(thin[:20]).all()
    short = np.array([1.0, np.nan, 2.0])
    assert envelope(short, 10) is short


def test_no_line_is_drawn_over_missing_times():
    time_s = np.concatenate((np.arange(50.0), np.arange(80.0, 100.0), np.arange(102.0, 110.0)))
    broken_s, values = broken_at_gaps(time_s, 2.0 * time_s)
    (gap,) = np.flatnonzero(np.isnan(values))
    assert (broken_s[gap - 1], broken_s[gap + 1]) == (49.0, 80.0)
    kept = np.delete(np.arange(broken_s.size), gap)
    np.testing.assert_array_equal(broken_s[kept], time_s)
    np.testing.assert_array_equal(values[kept], 2.0 * time_s)
    one = np.ones(1)
    np.testing.assert_array_equal(broken_at_gaps(one, one)[1], one)
