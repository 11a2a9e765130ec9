"""The verdict: more than noise that is left is never called explained, whatever tells what it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezod.diagnose.findings import Finding, Findings, above_noise, gap_closed
from piezod.diagnose.verdict.verdict import structured_share, verdict_of, widest_range, with_lower_confidence


def named(confidence):
    return SimpleNamespace(confidence=confidence)


@pytest.mark.parametrize(
    ("share", "closed", "confidences", "above", "verdict"),
    [
        (0.0, 1.0, (), False, "matches"),
        (0.0, 1.0, (), True, "unexplained"),
        (0.2, 0.0, (), False, "unexplained"),
        (0.0, 1.0, (0.9,), False, "explained"),
        (0.0, 0.999, (0.9,), True, "partly_explained"),
        (0.2, 0.99, (0.9,), False, "explained"),
        (0.2, 0.9, (0.9,), False, "partly_explained"),
        (0.2, 0.99, (0.4,), False, "partly_explained"),
    ],
)
def test_a_verdict_follows_from_what_is_left(share, closed, confidences, above, verdict):
    assert verdict_of(share, closed, [named(one) for one in confidences], above=above) == verdict


@pytest.mark.parametrize(
    ("after", "floor", "above"), [(0.12, 0.1, False), (0.14, 0.1, True), (0.024, 0.0, False), (0.03, 0.0, True)]
)
def test_more_than_noise_is_left_beyond_what_holds_show_and_any_model_can_reach(after, floor, above):
    assert (
        above_noise(after, floor, widest_range([recorded("identification", 1e6), recorded("recording", 100.0)]))
        is above
    )


def recorded(role, range_N):
    reading_N = np.linspace(0.0, range_N, 1000)
    return SimpleNamespace(role=role, reading_N=reading_N, counts=np.ones(reading_N.size, dtype=bool))


def test_words_and_verdict_mean_the_same_by_more_than_noise():
    findings = Findings("matches", "", "N", 0.0, "quiet", (), (), 1.0, 0.024, 90.0, 99.0, 0.0)
    assert findings.above_noise
    assert not replace(findings, span=100.0).above_noise


def test_names_beside_which_more_than_noise_is_left_are_believed_less():
    closed = gap_closed(1.1, 0.2, 0.1)
    assert closed == pytest.approx((1.21 - 0.04) / (1.21 - 0.01))
    found = Finding("creep", "creep", 0.99, "since", (), {}, 1.1, 0.2)
    assert with_lower_confidence(found, 0.0, closed).confidence == pytest.approx(0.99 * 0.9 * 0.975)
    assert with_lower_confidence(found, 0.0, 1.0).confidence == 0.99


def test_a_name_is_believed_by_what_it_explains_beside_all_that_is_no_noise():
    # Three squared units explained, three left beside one of noise, of no shape that anything could explain.
    left = structured_share(0.0, 2.0, 1.0, above=True)
    assert left == pytest.approx(0.75)
    found = Finding("friction", "friction", 0.8, "since", (), {}, 7.0**0.5, 2.0)
    assert with_lower_confidence(found, left, 1.0).confidence == pytest.approx(0.4)
    assert structured_share(0.9, 2.0, 1.0, above=True) == 0.9
    assert structured_share(0.05, 2.0, 1.9, above=False) == 0.05


def test_the_closed_gap_is_zero_without_a_gap_and_negative_for_a_larger_error():
    assert gap_closed(0.1, 0.1, 0.1) == 0.0
    assert gap_closed(1.0, 1.2, 0.1) < 0.0
