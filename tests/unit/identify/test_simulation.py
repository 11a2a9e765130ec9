"""Free run beside a measurement: what agrees as it is, and what only after gain and offset are refitted."""

from pathlib import Path

import numpy as np
import pytest

from piezod.errors import RecordingError, UsageError
from piezod.estimation.recordings.chosen_samples import outside, where
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.identify.simulation import FORGOTTEN, Agreement, simulate_recording
from piezod.model import load_model
from piezod.recording import Recording, read_csv

FLEXURE = Path(__file__).parents[4] / "shared" / "recordings" / "piezo-flexure"


def test_a_gain_and_an_offset_are_found_and_taken_out():
    simulated = np.sin(np.linspace(0.0, 20.0, 1000))
    agreement = Agreement.of(1.5 * simulated - 2.0, simulated)
    assert (agreement.gain, agreement.offset) == (pytest.approx(1.5), pytest.approx(-2.0))
    assert agreement.rms == pytest.approx(np.sqrt(np.mean((0.5 * simulated - 2.0) ** 2)))
    assert agreement.rms_refitted < 1e-12
    assert agreement.nrmse_percent_refitted == pytest.approx(100.0)


def test_a_condition_chooses_samples():
    recording = Recording(np.arange(4.0), {"on": np.array([0.0, 1.0, 1.0, 0.0])})
    assert where(recording, "on=1").tolist() == [False, True, True, False]
    with pytest.raises(UsageError, match="must be COLUMN=NUMBER"):
        where(recording, "on")
    with pytest.raises(RecordingError, match="has no column off"):
        where(recording, "off=1")


def test_stretches_are_left_out_with_both_their_ends():
    recording = Recording(np.arange(6.0), {"on": np.zeros(6)})
    assert outside(recording, ["1:2", "4.5:9"]).tolist() == [True, False, False, True, True, False]
    assert outside(recording, []).all()
    for wrong in ("1", "a:b", "", "nan:2"):
        with pytest.raises(UsageError, match=r"must be FROM:TO in seconds|must begin before it ends"):
            outside(recording, [wrong])
    with pytest.raises(UsageError, match="must begin before it ends"):
        outside(recording, ["2:1"])


@pytest.mark.parametrize("history_V", [(120.0, 0.0), (80.0, 30.0, 70.0), (60.0,)])
@pytest.mark.parametrize("amid", ["rising", "falling"])
def test_a_past_that_is_not_known_is_no_error_of_the_model(history_V, amid):
    """Recorded from the model itself after any past: what is left is what straight pieces leave of a curve."""
    model = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
    time_s = np.arange(0.0, 20.0, 0.005)
    sign = 1.0 if amid == "rising" else -1.0
    u = 55.0 + sign * (15.0 + 2.0 * time_s) * np.sin(np.pi * time_s)
    operator = model.hysteresis.operator()
    operator.run(np.array(history_V))
    noise_N = 0.05 * np.random.default_rng(3).standard_normal(u.size)
    channels = {model.input.channel: u, model.output.channel: operator.run(u) + noise_N}
    simulation = simulate_recording(model, Recording(time_s, channels, {}, "amid"), 1.0)
    assert "what came before is fitted" in simulation.start
    assert simulation.agreement.rms_tared < FORGOTTEN * (model.output.high - model.output.low)


@pytest.mark.skipif(not FLEXURE.exists(), reason="the recordings in ../shared are not here")
def test_what_does_not_transfer_to_the_tracking_record_is_above_all_gain_and_offset():
    options = Options(output="displacement_um", orders=True)
    model = identify([read_csv(FLEXURE / "identification.csv")], options, "a test").model
    tracking = read_csv(FLEXURE / "tracking.csv")
    off = simulate_recording(model, tracking, 1.0, where(tracking, "feedforward_on=0")).agreement
    print(off.words("um"))
    assert 1.0 < off.rms < 2.0
    assert off.rms_refitted < off.rms / 2.5
    assert 1.02 < off.gain < 1.06
