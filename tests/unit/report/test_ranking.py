"""The better model: rms error first, then hysteresis, in units of the noise."""

from dataclasses import dataclass

import numpy as np
import pytest

from piezod.recording import Recording
from piezod.report.ranking import Score, best_of, gain_text, in_noises
from piezod.report.tracking.validation import evaluate_validation
from piezod.session.task import Outcome

NOISE_N = 0.1


@dataclass
class Triangle:
    amplitude_N: float = 50.0
    offset_N: float = 100.0
    frequency_Hz: float = 0.5


def test_a_smaller_loop_does_not_outweigh_three_times_the_rms_error():
    scores = {"narrow": Score(3.0, 0.64), "close": Score(1.0, 0.89)}
    assert best_of(scores, NOISE_N) == "close"


def test_equal_rms_errors_are_decided_by_the_hysteresis():
    scores = {"wide": Score(1.000, 0.9), "narrow": Score(1.009, 0.6)}  # 0.09 noises apart
    assert best_of(scores, NOISE_N) == "narrow"
    assert best_of(scores, None) == "wide"  # without a noise no difference is known to be small


def test_a_missing_loop_leaves_the_rms_error_to_decide():
    assert best_of({"a": Score(1.0, None), "b": Score(1.005, 0.1)}, NOISE_N) == "a"


def test_an_error_is_told_in_noises_or_in_its_unit():
    assert in_noises(0.35, NOISE_N, "N") == "3.50 noises"
    assert in_noises(0.35, None, "N") == "0.350 N"


def test_a_gain_is_told_in_noises():
    scores = {"a": Score(0.2), "b": Score(0.5), "c": Score(0.205)}
    assert gain_text("a", "b", scores, NOISE_N, "N") == "a is better than b by 3.00 noises"
    assert gain_text("a", "c", scores, NOISE_N, "N") == "a and c do not differ by more than the noise shows"


def validated(errors):
    """A validation whose runs differ from the reference by functions of time and direction [N]."""
    time_s = np.arange(0.0, 6.0, 1e-3)
    phase = time_s * 0.5
    reference = 100.0 + 50.0 * (1.0 - 4.0 * np.abs(phase % 1.0 - 0.5))
    rising = phase % 1.0 < 0.5
    recordings = {}
    for seed, (name, error) in enumerate(errors.items()):
        noise = NOISE_N * np.random.default_rng(seed).standard_normal(time_s.size)
        channels = {"reference_N": reference, "force_N": reference + error(rising) + noise}
        recordings["only", name] = Recording(time_s, channels)
    return evaluate_validation({"only": Triangle()}, list(errors), (50.0, 150.0), recordings, Outcome())


def loop_of(width_N):
    return lambda rising: np.where(rising, -0.5, 0.5) * width_N


def offset_of(error_N):
    return lambda rising: np.full(rising.size, error_N)


def test_a_validation_knows_its_noise_from_the_repeats():
    verdict = validated({"without": loop_of(12.0), "a": offset_of(0.0)})
    assert verdict.noise_N == pytest.approx(NOISE_N, rel=0.03)


def test_a_validation_prefers_three_times_less_error_to_a_narrower_loop():
    verdict = validated({"without": loop_of(12.0), "no_loop": offset_of(1.5), "a_loop": loop_of(0.9)})
    assert verdict.mean_hysteresis_percent["no_loop"] < verdict.mean_hysteresis_percent["a_loop"]
    assert verdict.scores["no_loop"].rms > 3.0 * verdict.scores["a_loop"].rms
    assert verdict.better == "a_loop"
    assert verdict.scores["a_loop"].rms == pytest.approx(np.hypot(0.45, NOISE_N), rel=0.01)
    assert verdict.sentence.startswith("a_loop is the better model: rms error 4.5")  # 0.459 over 0.1006 N
    assert "a_loop is better than no_loop by 10." in verdict.sentence


def test_a_model_worse_than_none_is_told():
    verdict = validated({"without": loop_of(1.0), "bad": offset_of(5.0)})
    assert not verdict.better_than_none
    assert verdict.sentence.endswith("it is NOT better than no model")
