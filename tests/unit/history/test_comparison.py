"""Two models are compared parameter by parameter, over the range in which both stacks were driven."""

import json
from pathlib import Path

import pytest

from piezod.errors import UsageError
from piezod.history.comparison import compare_models
from piezod.model import load_model, save_model
from piezod.model.parameters import EffectValues
from piezod.report.history import model_comparison_text, write_model_comparison_page
from tests.contract.test_commands import run

SHIPPED = Path(__file__).parents[3] / "config" / "model.yaml"


def delay(delay_s, low_s, high_s):
    return EffectValues(name="transport_delay", parameters={"delay_s": delay_s}, intervals={"delay_s": (low_s, high_s)})


def saved(path, *, gain=1.0, effects=(), high=None, unit="N"):
    """The shipped model with another gain, range, unit of the output, and effects."""
    model = load_model(SHIPPED)
    zones = model.hysteresis.dead_zones
    scaled = zones.model_copy(update={"weights": tuple(gain * weight for weight in zones.weights)})
    changes = {
        "hysteresis": model.hysteresis.model_copy(update={"dead_zones": scaled}),
        "effects": tuple(effects),
        "input": model.input if high is None else model.input.model_copy(update={"high": high}),
        "output": model.output.model_copy(update={"unit": unit}),
    }
    save_model(model.model_copy(update=changes), path)
    return path


def test_equal_stacks_have_no_parameter_that_differs(tmp_path):
    first, second = saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml")
    assert compare_models(first, second).verdict == "no parameter differs beyond chance, of 2 compared"


def test_a_delay_beyond_its_interval_differs_with_its_z(tmp_path):
    first = saved(tmp_path / "a.yaml", effects=[delay(0.010, 0.009, 0.011)])
    second = saved(tmp_path / "b.yaml", effects=[delay(0.015, 0.014, 0.016)])
    comparison = compare_models(first, second)
    assert comparison.verdict == "transport delay: delay differs; 2 of 3 compared parameters agree"
    (late,) = [one for one in comparison.parameters if one.key.effect == "transport_delay"]
    assert late.z == pytest.approx(0.005 / (2**0.5 * 0.001 / 1.959964))
    assert "+6.9  differs" in model_comparison_text(comparison)


def test_an_effect_of_one_stack_only_is_named_with_its_file(tmp_path):
    first = saved(tmp_path / "a.yaml", effects=[delay(0.010, 0.009, 0.011)])
    comparison = compare_models(first, saved(tmp_path / "b.yaml"))
    assert comparison.verdict.startswith("only a.yaml has transport delay; 2 of 2 compared")
    assert comparison.as_dict()["effects"] == {"base": "kept", "transport_delay": "gone"}


def test_a_gain_beyond_the_assumed_interval_differs_and_the_note_states_it(tmp_path):
    comparison = compare_models(saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml", gain=1.05))
    assert comparison.verdict == "stack: gain differs; 1 of 2 compared parameters agree"
    assert any("assumed: 1 % of base.gain" in note for note in comparison.notes)


def test_the_base_is_compared_over_the_common_range(tmp_path):
    comparison = compare_models(saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml", high=60.0))
    assert comparison.driven == (load_model(SHIPPED).input.low, 60.0)
    gain = comparison.parameters[0]
    assert gain.before.value == gain.after.value
    assert any("common range" in note for note in comparison.notes)


def test_models_of_other_quantities_are_refused_in_one_line(tmp_path):
    first, second = saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml", unit="um")
    with pytest.raises(UsageError, match="compare models of one kind") as caught:
        compare_models(first, second)
    assert "\n" not in str(caught.value)


def test_the_command_compares_two_model_files_and_recordings_as_before(tmp_path, capsys):
    first, second = saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml", gain=1.05)
    code, out, _ = run(["compare", first, second, "--json"], capsys)
    assert code == 0
    content = json.loads(out)
    assert content["schema"] == "piezod.model_comparison/1"
    assert content["parameters"]["base.gain"]["changed"]
    code, out, err = run(["compare", first], capsys)
    assert (code, out) == (2, "")
    assert "nothing to compare with" in err


def test_the_page_holds_the_verdict_and_every_parameter(tmp_path):
    comparison = compare_models(saved(tmp_path / "a.yaml"), saved(tmp_path / "b.yaml", gain=1.05))
    write_model_comparison_page(tmp_path / "page.html", comparison)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Stack: gain differs" in page
    assert page.count("<tr>") == 3
