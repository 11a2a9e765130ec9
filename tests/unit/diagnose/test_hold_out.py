"""Recordings that are held out: each is compared, whatever its past, and none ends the diagnosis."""

import json

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from tests.benches.plain_stack import NOISE_N, RATE_HZ, record, triangles, work

TIME_S = np.arange(0.0, 8.0, 1.0 / RATE_HZ)
HELD_OUT = {  # by what no play of more than their swing forgets
    "sine amid the range": 50.0 + 5.0 * np.sin(np.pi * TIME_S),
    "small steps at the top": 90.0 + 2.0 * np.repeat(np.arange(8) % 3, TIME_S.size // 8),
    "a voltage that stands": np.full(TIME_S.size, 60.0),
}


@pytest.fixture(scope="module")
def findings(tmp_path_factory):
    """What a diagnosis says with these recordings held out, each driven up and down before it begins."""
    folder = tmp_path_factory.mktemp("held_out")
    piezod.identify(str(record(folder / "identification.csv", triangles([100, 40, 80, 60, 100, 30]), 1))).model.save(
        folder / "model.yaml"
    )
    record(folder / "work.csv", work(3, 12.0), 2)
    paths = []
    for number, (name, voltage_V) in enumerate(HELD_OUT.items()):
        led_V = np.interp(np.arange(600), [0, 200, 400, 600], [0.0, 100.0, 20.0, voltage_V[0]])
        paths.append(record(folder / f"{name}.csv", np.concatenate((led_V, voltage_V)), 5 + number))
        lines = paths[-1].read_text(encoding="utf-8").splitlines()
        paths[-1].write_text("\n".join((lines[0], *lines[1 + led_V.size :])), encoding="utf-8")
    out = folder / "out"
    diagnose_files([folder / "work.csv"], folder / "model.yaml", out, None, None, lambda *_: None, hold_out=paths)
    return json.loads((out / "findings.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", HELD_OUT)
def test_a_recording_whose_memory_never_settles_is_compared_from_a_start_that_is_estimated(findings, name):
    told = next(one for one in findings["fit"]["held_out_recordings"] if name in one["path"])
    assert 0.0 < told["before"] < 4.0 * NOISE_N


def test_held_out_recordings_leave_the_verdict_of_a_true_model(findings):
    assert findings["verdict"] == "matches"
    assert len(findings["fit"]["held_out_recordings"]) == len(HELD_OUT)
