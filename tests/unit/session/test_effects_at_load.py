"""A model with an effect that has no inverse is refused, unless `compensation_without` names the effect."""

from pathlib import Path

import pytest
import yaml

from piezod.commissioning.check import check_model_effects
from piezod.effects import EFFECTS
from piezod.errors import ConfigurationError, ModelError
from piezod.model import load_model, make_compensator, save_model
from piezod.model.parameters import EffectValues
from piezod.model.unnamed_law import UnnamedLaw
from piezod.session.assembly import load_bench_and_model, load_bench_without_model

CONFIG = Path(__file__).parents[3] / "config"
REFUSED = [name for name, effect in EFFECTS.items() if effect.handling == "refused"]


def values(name):
    return EffectValues(
        name=name,
        parameters={one.name: (one.search.choices or one.search.starts)[0] for one in EFFECTS[name].parameters},
    )


def bench_with(folder, *names, **changes):
    model = load_model(CONFIG / "model.yaml")
    save_model(model.model_copy(update={"effects": tuple(map(values, names))}), folder / "model.yaml")
    content = yaml.safe_load((CONFIG / "bench.yaml").read_text(encoding="utf-8")) | {"model": "model.yaml"} | changes
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", REFUSED)
def test_an_effect_without_an_inverse_is_refused_in_one_line_with_reason_and_remedy(name, tmp_path):
    with pytest.raises(ModelError) as refused:
        load_bench_and_model(bench_with(tmp_path, "creep", name))
    text = str(refused.value)
    assert "\n" not in text
    assert f"model.yaml: {name} cannot be compensated: " in text
    assert EFFECTS[name].why in text
    assert f"compensation_without: [{name}]" in text


@pytest.mark.parametrize("name", REFUSED)
def test_an_effect_in_compensation_without_is_not_compensated_and_the_check_warns(name, tmp_path):
    path = bench_with(tmp_path, "creep", name, compensation_without=[name])
    bench, model = load_bench_and_model(path)
    checks = list(check_model_effects(bench, model, path))
    assert [(one.level, one.found.partition(":")[0]) for one in checks] == [("OK", "creep"), ("WARN", name)]
    with_it, without = (
        make_compensator("inverse", one, bench.dt_s, bench.compensation_without)
        for one in (model, model.model_copy(update={"effects": (values("creep"),)}))
    )
    assert with_it.plan(100.0) == without.plan(100.0)


def test_a_rate_that_the_wire_does_not_carry_is_refused_at_load(tmp_path):
    path = bench_with(tmp_path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    kept = {key: content["link"][key] for key in ("unit_id", "timeout_s", "heartbeat_within_s", "registers")}
    content["link"] = kept | {"kind": "modbus_rtu", "port": "/dev/ttyS0", "baudrate": 9600}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="the wire of link does not carry"):
        load_bench_without_model(path)


def test_a_voltage_that_its_register_cannot_hold_is_refused_at_load(tmp_path):
    path = bench_with(tmp_path)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["link"]["registers"]["voltage_setpoint"] |= {"type": "int16", "order": "AB", "scale": 0.001}
    content["link"]["registers"]["command_sequence"]["address"] -= 1
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="voltage_setpoint"):
        load_bench_without_model(path)


def test_a_plain_gain_needs_no_inverse(tmp_path):
    _, model = load_bench_and_model(bench_with(tmp_path, "friction", compensation="gain"))
    assert [effect.name for effect in model.effects] == ["friction"]


def test_a_name_in_compensation_without_must_be_in_the_catalogue_and_in_the_model(tmp_path):
    with pytest.raises(ConfigurationError, match="compensation_without is 'gremlins', must be one of"):
        load_bench_and_model(bench_with(tmp_path, compensation_without=["gremlins"]))
    path = bench_with(tmp_path, compensation_without=["creep"])
    (check,) = check_model_effects(*load_bench_and_model(path), path)
    assert (check.level, check.found) == ("WARN", "creep: left out, but the model has none")


@pytest.mark.parametrize(
    ("size", "without", "level", "says"),
    [
        (1.0, [], "OK", "unnamed law: compensated"),
        (1e4, [], "WARN", "unnamed law: not compensated, it changes more within a tick than the force"),
        (1.0, ["unnamed_law"], "WARN", "unnamed law: not compensated, because of compensation_without"),
    ],
)
def test_the_check_says_what_becomes_of_an_unnamed_law(tmp_path, size, without, level, says):
    path = bench_with(tmp_path, compensation_without=without)
    axis = {"driver": "command", "low": 0.0, "high": 140.0, "nodes": 3}
    law = {"drivers": [axis], "dead_band": 1.0, "smoothing_s": 0.01, "memories_s": [0.0], "tables": [[0.0, size, 0.0]]}
    model = load_model(tmp_path / "model.yaml").model_copy(update={"unnamed_law": UnnamedLaw.model_validate(law)})
    save_model(model, tmp_path / "model.yaml")
    (check,) = check_model_effects(*load_bench_and_model(path), path)
    assert (check.level, check.found) == (level, says)
