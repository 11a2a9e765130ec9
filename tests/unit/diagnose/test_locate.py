"""Places: what is planted is found where it is, and noise of any colour has no place."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.localisation.locate import locate
from tests.unit.diagnose.residuals import (
    crept,
    lagged,
    mixed_work,
    model_of,
    noise,
    played,
    series,
    time,
    triangles,
)

SAMPLES = 30_000


def places_of(u, missing_N, *, rho=0.0, noise_N=0.5, seed=1, **how):
    time_s = time(u.size)
    residual = missing_N + noise_N * noise(u.size, rho, np.random.default_rng(seed))
    return locate([series(time_s, u, model_of(u) + residual, noise_N, **how)], [residual], [model_of(u)])


def on(places, axis):
    return [one for one in places if one.axis == axis]


@pytest.mark.slow
@pytest.mark.parametrize("drive", [mixed_work, triangles])
def test_noise_has_no_place_more_often_than_five_in_a_hundred_whatever_its_colour(drive):
    time_s = time(6000)
    u = drive(time_s)
    alarms = [
        bool(places_of(u, 0.0, rho=rho, noise_N=1.0, seed=seed))
        for rho, seeds in ((0.0, range(35)), (0.9, range(40, 75)), (0.98, range(80, 115)))
        for seed in seeds
    ]
    assert np.mean(alarms) <= 0.08


def test_a_model_that_is_followed_exactly_has_no_place():
    u = mixed_work(time(SAMPLES))
    assert places_of(u, np.zeros(SAMPLES), noise_N=1e-300) == []


@pytest.mark.parametrize("drive", [mixed_work, triangles])
def test_a_lag_is_found_in_the_rate_and_it_changes_sign_with_the_direction(drive):
    u = drive(time(SAMPLES))
    places = places_of(u, lagged(model_of(u), 0.008) - model_of(u))
    fastest = float(np.quantile(np.abs(np.gradient(u, 1e-3)), 0.99))
    assert max(one.high for one in on(places, "rate_V_per_s")) >= 0.99 * fastest
    assert [(one.low, one.high) for one in on(places, "direction")] == [(-1.0, 1.0)]


@pytest.mark.parametrize("drive", [mixed_work, triangles])
def test_a_load_step_is_found_between_its_edges(drive):
    time_s = time(SAMPLES)
    places = places_of(drive(time_s), 0.6 * ((time_s > 9.0) & (time_s < 16.0)))
    assert places[0].axis == "time_s"
    assert places[0].low == pytest.approx(9.0, abs=0.7)
    assert places[0].high == pytest.approx(16.0, abs=0.7)
    assert places[0].share > 0.8


def test_times_are_those_of_the_recording():
    time_s = time(SAMPLES)
    places = places_of(mixed_work(time_s), 0.6 * ((time_s > 9.0) & (time_s < 16.0)), start_s=100.0)
    assert places[0].low == pytest.approx(109.0, abs=0.7)


def test_a_line_is_a_place_without_width_at_its_frequency():
    time_s = time(SAMPLES)
    places = places_of(mixed_work(time_s), 0.2 * np.sin(2.0 * np.pi * 61.37 * time_s))
    (line,) = [one for one in places if one.low == one.high]
    assert line.axis == "frequency_Hz"
    assert line.low == pytest.approx(61.37, abs=0.01)


def test_a_clamp_is_found_at_the_voltages_that_it_cuts():
    u = triangles(time(SAMPLES))
    places = places_of(u, -0.2 * np.maximum(model_of(u) - 190.0, 0.0))
    clamp = on(places, "voltage_V")[0]
    assert 190.0 / 1.8 <= clamp.low <= 190.0 / 1.8 + 10.0  # below its middle it is less than its own mean
    assert clamp.high == pytest.approx(120.0)
    assert clamp.share > 0.5


def test_creep_is_found_in_the_history_and_over_more_than_a_decade_of_it():
    u = mixed_work(time(SAMPLES))
    history = on(places_of(u, 0.01 * crept(model_of(u))), "history_s")
    assert history
    assert max(one.high for one in history) > 10.0 * min(one.low for one in history)


def test_a_wider_loop_is_found_behind_reversals():
    u = mixed_work(time(SAMPLES))
    places = places_of(u, 0.1 * (played(u, 8.0) - u))
    assert on(places, "amplitude_V")


def test_what_follows_the_temperature_is_found_over_it():
    time_s = time(SAMPLES)
    warm = 25.0 + 2.0 * np.sin(2.0 * np.pi * 0.05 * time_s)
    places = on(places_of(triangles(time_s), 0.3 * (warm - 25.0), temperature_C=warm), "temperature_C")
    assert places
    assert all(25.0 < one.low < 27.1 or 22.9 < one.high < 25.0 for one in places)


def test_a_burst_is_found_when_it_is():
    time_s = time(SAMPLES)
    burst = 4.0 * np.random.default_rng(3).standard_normal(SAMPLES) * ((time_s > 12.0) & (time_s < 12.2))
    (place,) = places_of(mixed_work(time_s), burst)
    assert place.axis == "time_s"
    assert place.low <= 12.0
    assert place.high >= 12.2
    assert place.high - place.low < 1.3


def test_a_recording_that_the_model_was_identified_on_is_not_looked_at():
    u = mixed_work(time(SAMPLES))
    assert places_of(u, lagged(model_of(u), 0.008) - model_of(u), role="identification") == []


def test_readings_that_do_not_count_do_not_matter():
    time_s = time(SAMPLES)
    u, wrong = mixed_work(time_s), (time_s > 5.0) & (time_s < 6.0)
    residual = 0.5 * noise(SAMPLES, 0.0, np.random.default_rng(5))
    one = series(time_s, u, model_of(u) + residual, 0.5, counts=~wrong)
    residual[wrong] = np.nan
    assert locate([one], [residual], [model_of(u)]) == []


def test_two_recordings_tell_together_what_neither_tells_alone():
    time_s = time(10_000)
    u = mixed_work(time_s)
    missing = 0.035 * np.sign(np.gradient(u))
    residuals = [missing + noise(u.size, 0.0, np.random.default_rng(seed)) for seed in range(8)]
    one = series(time_s, u, model_of(u))
    alone = [locate([one], [residual], [model_of(u)]) for residual in residuals[:4]]
    together = locate([replace(one)] * 8, residuals, [model_of(u)] * 8)
    assert on(together, "direction")
    assert sum(bool(on(places, "direction")) for places in alone) < 4


def test_the_same_seed_gives_the_same_places():
    u = mixed_work(time(SAMPLES))
    missing = lagged(model_of(u), 0.008) - model_of(u)
    assert places_of(u, missing) == places_of(u, missing)
