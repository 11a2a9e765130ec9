"""An input that is not recorded: told with its place and size where nothing else explains what is left."""

import numpy as np
import pytest

from piezod.diagnose.adequacy.unrecorded import unrecorded_input
from piezod.diagnose.findings import Findings, Unrecorded
from piezod.diagnose.verdict.verdict import words_of
from piezod.diagnose.verdict.words import Wording
from piezod.report.diagnosis.wording import remaining_error
from tests.unit.diagnose.residuals import mixed_work, series, time

SAMPLES = 6000
NOISE_N = 0.1


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def steps(rng, every, size):
    return np.repeat(rng.uniform(-1.0, 1.0, SAMPLES // every + 1), every)[:SAMPLES] * size


def told(left_N, modelled_N, predicted=0.05, **changes):
    one = series(time(SAMPLES), modelled_N / 2.0, modelled_N + left_N, NOISE_N, **changes)
    return unrecorded_input([one], [left_N], [modelled_N], predicted)


@pytest.fixture
def work_N():
    return 2.0 * mixed_work(time(SAMPLES))


@pytest.mark.parametrize(("every", "size"), [(40, 0.1), (200, 0.02), (40, 0.5)])
def test_a_gain_that_somebody_turns(work_N, rng, every, size):
    left_N = steps(rng, every, size) * (work_N - 30.0) + NOISE_N * rng.standard_normal(SAMPLES)
    found = told(left_N, work_N)
    assert found.gain
    assert found.size == pytest.approx(size / np.sqrt(3.0), rel=0.25)  # uniform between both ends
    dt_s = time(2)[1]
    assert found.keeps_s == pytest.approx(every * dt_s, rel=0.35)


def test_a_second_actuator_beside_the_stack(work_N, rng):
    left_N = steps(rng, 100, 5.0) + NOISE_N * rng.standard_normal(SAMPLES)
    found = told(left_N, work_N)
    assert not found.gain
    assert found.size == pytest.approx(5.0 / np.sqrt(3.0), rel=0.2)


def test_noise_is_none_whatever_its_size(work_N, rng):
    assert told(20.0 * rng.standard_normal(SAMPLES), work_N) is None


def test_what_the_drive_predicts_is_a_law_that_is_missing(work_N):
    assert told(0.01 * (work_N - 60.0) ** 2, work_N, predicted=0.9) is None


def test_recordings_of_the_identification_are_not_asked(work_N, rng):
    quiet_N, left_N = NOISE_N * rng.standard_normal(SAMPLES), steps(rng, 100, 5.0)
    shown = series(time(SAMPLES), work_N / 2.0, work_N + quiet_N, NOISE_N)
    given = series(time(SAMPLES), work_N / 2.0, work_N + left_N, NOISE_N, role="identification")
    assert unrecorded_input([given, shown], [left_N, quiet_N], [work_N, work_N], 0.05) is None


def test_verdict_page_and_json_say_it():
    findings = Findings(
        verdict="unexplained",
        words="",
        unit="N",
        floor=2.0,
        floor_from="quiet",
        where=(),
        effects=(),
        before=98.0,
        after=98.0,
        nrmse_before=10.0,
        nrmse_after=10.0,
        explainable=0.1,
        unrecorded=Unrecorded(0.34, gain=True, keeps_s=0.05),
    )
    for said in (words_of(findings, Wording("V", "N")), remaining_error(findings)[-1]):
        assert "input that is not recorded, a gain of 34 % rms, which keeps its value for about 0.050 s" in said
    told = findings.as_dict()["unexplained"]["unrecorded_input"]
    assert told == {"size": {"value": 0.34, "unit": "1"}, "form": "gain", "keeps_s": 0.05}
