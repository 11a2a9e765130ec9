"""Tones that are taken off: hum whose harmonic meets its own reflection at half the sampling rate."""

import numpy as np
import pytest

from piezod.diagnose.candidates.direct import level_about, lines
from piezod.diagnose.candidates.tones import swing_with_command, tones
from piezod.estimation.recordings.series import Series
from tests.unit.diagnose.residuals import mixed_work, model_of, noise

NOISE_N = 0.5


@pytest.mark.parametrize(("rate_Hz", "harmonic"), [(200.0, 2), (500.0, 5), (500.0, 3), (1000.0, 3)])
@pytest.mark.parametrize("mains_Hz", [49.97, 50.039, 50.0])
def test_a_harmonic_at_half_the_sampling_rate_goes_with_its_hum(rate_Hz, harmonic, mains_Hz):
    time_s = np.arange(0.0, 40.0, 1.0 / rate_Hz)
    u, angle = mixed_work(time_s), 2.0 * np.pi * mains_Hz * time_s + 0.7
    white_N = NOISE_N * noise(time_s.size, 0.0, np.random.default_rng(1))
    residual_N = white_N + 20.0 * np.sin(angle) + 2.0 * np.sin(harmonic * angle + 0.4)
    one = Series("by hand", "recording", time_s, u, model_of(u) + residual_N, np.ones(time_s.size, bool), NOISE_N)
    groups = tones([one], [residual_N], ())
    assert [tone.name for group in groups for tone in group] == ["mains_hum"]
    left_N = residual_N - groups[0][0].signal_N
    assert float(np.std(left_N)) < 1.1 * NOISE_N
    assert groups[0][0].values["amplitude_N"] == pytest.approx(20.0, rel=0.01)


@pytest.mark.parametrize("mains_Hz", [49.97, 50.025, 50.1])
def test_harmonics_that_appear_beside_each_other_are_both_the_hums(mains_Hz):
    time_s = np.arange(0.0, 60.0, 1.0 / 500.0)  # the 3rd and the folded 7th, 0.25 to 1 Hz apart
    u, angle = mixed_work(time_s), 2.0 * np.pi * mains_Hz * time_s + 0.7
    white_N = NOISE_N * noise(time_s.size, 0.0, np.random.default_rng(1))
    residual_N = white_N + 17.0 * np.sin(angle) + 5.6 * np.sin(3.0 * angle + 0.4) + 2.7 * np.sin(7.0 * angle)
    one = Series("by hand", "recording", time_s, u, model_of(u) + residual_N, np.ones(time_s.size, bool), NOISE_N)
    groups = tones([one], [residual_N], ())
    assert [tone.name for group in groups for tone in group] == ["mains_hum"]
    left_N = residual_N - groups[0][0].signal_N
    assert float(np.std(left_N)) < 1.1 * NOISE_N
    assert not tones([one], [white_N + 0.5 * np.sin(7.0 * angle)], groups[0])  # no vibration either when it is alone


@pytest.mark.parametrize(("mains_Hz", "machine_Hz", "together"), [(49.9, 17.02, True), (60.1, 19.0, False)])
def test_a_tone_of_the_identification_goes_with_the_recordings_and_never_alone(mains_Hz, machine_Hz, together):
    time_s = np.arange(0.0, 40.0, 2e-3)
    u, made, residuals_N = mixed_work(time_s), [], []
    for number, (role, f_Hz) in enumerate((("identification", (mains_Hz, machine_Hz)), ("recording", (50.1, 17.0)))):
        white_N = NOISE_N * noise(time_s.size, 0.0, np.random.default_rng(number))
        residuals_N.append(
            white_N + sum(size * np.sin(2.0 * np.pi * f * time_s) for size, f in zip((20.0, 5.0), f_Hz, strict=True))
        )
        made.append(Series("by hand", role, time_s, u, u + residuals_N[-1], np.ones(time_s.size, bool), NOISE_N))
    groups = tones(made, residuals_N, ())
    heard = [[(tone.name, tone.number) for tone in group] for group in groups]
    numbers = (1, 0) if together else (1,)
    assert heard == [[("mains_hum", k) for k in numbers], [("vibration", k) for k in numbers]]
    assert not tones(made, residuals_N, [group[0] for group in groups])


@pytest.mark.parametrize(("depth", "period_s"), [(0.0, 20.0), (0.09, 50.0), (0.2, 30.0), (0.4, 12.0)])
def test_the_written_vibration_breathes_as_the_heard_one(depth, period_s):
    time_s = np.arange(0.0, 52.0, 2e-3)
    swell = 1.0 + depth * np.sin(2.0 * np.pi * time_s / period_s + 0.9)
    white_N = NOISE_N * noise(time_s.size, 0.0, np.random.default_rng(3))
    residual_N = white_N + 9.0 * swell * np.sin(2.0 * np.pi * 28.1451 * time_s + 0.4)
    u = mixed_work(time_s)
    one = Series("by hand", "recording", time_s, u, model_of(u) + residual_N, np.ones(time_s.size, bool), NOISE_N)
    ((tone,),) = tones([one], [residual_N], ())
    turns = 2.0 * np.pi * time_s
    written = 1.0 + tone.values["breathing_depth"] * np.sin(
        turns / tone.values["breathing_period_s"] + tone.values["breathing_phase_rad"]
    )
    carrier = np.sin(tone.values["frequency_Hz"] * turns + tone.values["phase_rad"])
    left_N = residual_N - tone.values["amplitude_N"] * written * carrier
    assert float(np.std(left_N)) < 1.1 * NOISE_N
    assert (tone.values["breathing_depth"] > 0.0) == (depth > 0.0)


@pytest.mark.parametrize("swing", [0.0, 0.15, 0.55, 1.0, 3.0, 30.0])
def test_a_tone_that_swings_with_the_command_is_no_vibration(swing):
    time_s = np.arange(0.0, 40.0, 1e-3)
    u = mixed_work(time_s)
    amplitude_N = 2.0 * (1.0 + swing * (u - u.mean()) / u.std())
    white_N = NOISE_N * noise(time_s.size, 0.0, np.random.default_rng(2))
    residual_N = white_N + amplitude_N * np.sin(2.0 * np.pi * 31.7 * time_s + 0.3)
    one = Series("by hand", "recording", time_s, u, model_of(u) + residual_N, np.ones(time_s.size, bool), NOISE_N)
    assert swing_with_command(one, residual_N, 31.7) == pytest.approx((2.0, 2.0 * swing), abs=0.05)
    named = [tone.name for group in tones([one], [residual_N], ()) for tone in group]
    deepest = (u.mean() - u.min()) / u.std()  # 1.8: there the tone of a gain is gone with a swing of 0.55
    assert named == (["vibration"] if swing * deepest < 0.5 else [])


@pytest.mark.parametrize("at_Hz", [2.0, 50.0, 121.7, 499.0])
def test_the_level_about_a_tone_is_that_of_its_own_colour(at_Hz):
    time_s, rho, found_N = np.arange(0.0, 20.0, 1e-3), 0.9, []
    for seed in range(20):
        coloured_N = noise(time_s.size, rho, np.random.default_rng(seed))
        one = Series("by hand", "recording", time_s, time_s, coloured_N, np.ones(time_s.size, bool), 1.0)
        found_N.append(level_about(one, coloured_N, at_Hz))
    turn = np.exp(-2j * np.pi * at_Hz * 1e-3)
    assert np.mean(found_N) == pytest.approx(np.sqrt(1.0 - rho**2) / abs(1.0 - rho * turn), rel=0.05)


@pytest.mark.parametrize("corner_Hz", [0.6, 1.0, 2.0])
def test_the_colour_of_slow_noise_is_no_vibration_and_a_vibration_in_it_is(corner_Hz):
    rate_Hz = 250.0
    time_s = np.arange(0.0, 30.0, 1.0 / rate_Hz)
    u, rho = mixed_work(time_s), float(np.exp(-2.0 * np.pi * corner_Hz / rate_Hz))
    for seed in range(20):
        coloured_N = NOISE_N * noise(time_s.size, rho, np.random.default_rng(seed))
        one = Series("by hand", "recording", time_s, u, model_of(u) + coloured_N, np.ones(time_s.size, bool), NOISE_N)
        assert lines(one, coloured_N) == []
        heard = lines(one, coloured_N + 3.0 * NOISE_N * np.sin(2.0 * np.pi * 1.7 * time_s + seed))
        assert [round(line.frequency_Hz, 1) for line in heard] == [1.7]
