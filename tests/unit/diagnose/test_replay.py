"""The replay file holds every hypothesis once, and its losses give the loss that the search saw."""

import json

import numpy as np
import pytest

from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.terms import Point
from piezod.diagnose.selection.replay import Attempt, write_replay
from piezod.errors import ConfigurationError

NONE = np.empty(0)
POINT = Point(NONE, NONE, NONE, ())


def fitted(*losses):
    left_out = np.array(losses)
    return Fitted((), POINT, left_out, left_out / 2, np.arange(1.0, left_out.size + 1), ())


def test_each_hypothesis_is_written_once_with_its_losses(tmp_path):
    base, first, second = fitted(4.0, 5.0), fitted(2.0, np.inf), fitted(3.0, 1.0)
    attempts = [Attempt("one", 0, base, one, degenerate=False, accepted=one is second) for one in (first, second)]
    write_replay(tmp_path / "replay.json", attempts)
    content = json.loads((tmp_path / "replay.json").read_text())
    assert [(one["before"], one["after"], one["believed"]) for one in content["attempts"]] == [
        (0, 1, False),
        (0, 2, True),
    ]
    losses, in_fit, samples = (np.array(content["hypotheses"][2][name]) for name in ("losses", "in_fit", "samples"))
    assert losses @ samples / samples.sum() == pytest.approx(second.loss)
    np.testing.assert_allclose(in_fit, second.losses / 2)
    assert content["hypotheses"][1]["losses"] == [2.0, None]


def test_a_folder_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be written: No such file"):
        write_replay(tmp_path / "none" / "replay.json", [])
