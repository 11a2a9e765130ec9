"""A test sequence is read strictly; a bad file is one line with its line number."""

import pytest

from piezod.config.sequence import StepLimits, load_sequence
from piezod.errors import ConfigurationError

GOOD = """schema: piezod.sequence/1
name: acceptance
steps:
  - name: slow triangle
    reference: {kind: triangle, amplitude_N: 50.0, offset_N: 100.0, frequency_Hz: 0.5, duration_s: 4.0}
    limits: {rms_error_N: 0.5, max_hysteresis_percent: 1.0}
  - name: with the gain
    compensation: gain
    reference: {kind: sine, amplitude_N: 20.0, offset_N: 100.0, frequency_Hz: 1.0, duration_s: 2.0}
    limits:
      max_error_N: 30.0
      lowest_force_N: 10.0
      highest_force_N: 200.0
"""


def written(tmp_path, text):
    path = tmp_path / "test.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_sequence_is_read(tmp_path):
    sequence = load_sequence(written(tmp_path, GOOD))
    assert [step.name for step in sequence.steps] == ["slow triangle", "with the gain"]
    assert sequence.steps[0].limits.given == {"rms_error_N": 0.5, "max_hysteresis_percent": 1.0}
    assert [step.compensation for step in sequence.steps] == ["inverse", "gain"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("piezod.sequence/1", "piezod.bench/1", ": schema is 'piezod.bench/1', must be 'piezod.sequence/1'"),
        (
            "rms_error_N: 0.5",
            "rms_eror_N: 0.5",
            ":6: unknown key steps.0.limits.rms_eror_N, did you mean 'rms_error_N'?",
        ),
        ("rms_error_N: 0.5", "rms_error_N: -0.5", ":6: steps.0.limits.rms_error_N is -0.5, must be at least 0"),
        (
            "rms_error_N: 0.5, max_hysteresis_percent: 1.0",
            "",
            ":6: steps.0.limits: no limit is given, must be at least",
        ),
        (", duration_s: 4.0", "", ":5: steps.0: reference repeats without end, must end; give duration_s"),
        ("lowest_force_N: 10.0", "lowest_force_N: 300.0", ":12: steps.1.limits: lowest_force_N is 300, must be below"),
        ("with the gain", "slow triangle", ":3: steps: the name 'slow triangle' stands twice, must differ"),
        ("kind: triangle", "kind: register", "steps.0.reference.kind is 'register', must be one of 'triangle'"),
        ("kind: triangle", "kind: steps", "steps.0: limits.max_hysteresis_percent needs a reference of kind triangle"),
        ("name: acceptance", "name: ../etc", "name is '../etc'"),
        ("compensation: gain", "compensation: none", ":8: steps.1.compensation is 'none', must be 'inverse' or 'gain'"),
        ("steps:", "steps: []\nother:", "unknown key other"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, old, new, message):
    path = written(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as caught:
        load_sequence(path)
    assert "\n" not in str(caught.value)
    assert message in str(caught.value).replace(str(path), "")


def test_every_limit_is_named_in_the_message_for_none():
    with pytest.raises(ValueError, match=", ".join(StepLimits.model_fields)):
        StepLimits()
