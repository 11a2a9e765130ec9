"""The text of a status: shares, and an rms that holds its mean."""

import pytest

from piezod.daemon.status import _drift_text, missed_text


@pytest.mark.parametrize(("ticks", "missed", "text"), [(1000, 0, "0"), (995, 5, "5 (0.5 %)"), (0, 0, "0")])
def test_missed_ticks_have_their_share_of_those_due(ticks, missed, text):
    assert missed_text({"ticks": ticks, "missed": missed}) == text


def test_the_rms_is_never_below_the_mean():
    drift = {"rms_N": 0.3, "offset_N": -0.4, "limit_N": 0.2, "drifted": True, "kept": "/k.csv", "problem": ""}
    assert "0.50 N rms, -0.40 N in the mean" in _drift_text(drift)
