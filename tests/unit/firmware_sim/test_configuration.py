import pytest

from firmware_sim.config import LineCommand, configured_scenario, load_config
from firmware_sim.errors import ConfigurationError
from firmware_sim.physics.scenario import load_scenario, with_effects

HEAD = "schema: firmware_sim.emulator/1\n"


def load(folder, text):
    path = folder / "emulator.yaml"
    path.write_text(HEAD + text, encoding="utf-8")
    return load_config(path)


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("sead: 1\n", 2, "sead"),
        ("seed: 1\nseed: 2\n", 3, "twice"),
        ("seed: true\n", 2, "seed"),
        ("tcp:\n  port: 99999\n", 3, "tcp.port"),
        ("effects:\n  krep: true\n", 3, "krep"),
        ("effects:\n  creep: {per_decade: -1.0}\n", 3, "per_decade"),
        ("effects:\n  creep: {per_decade: .inf}\n", 3, "per_decade"),
        ("physics:\n  mechanics: {full_N: -3}\n", 1, "full_N"),
        ("physics:\n  wheels: 4\n", 1, "wheels"),
        ("scenario: nowhere\n", 1, "nowhere"),
        ("firmware: &f {}\nrtu: *f\n", 3, "alias"),
        ("firmware: [\n", 3, ""),
        ("firmware: {fault_bits: 1}\n", 2, "fault_bits"),
    ],
)
def test_a_bad_configuration_is_refused_with_its_line(tmp_path, text, line, part):
    with pytest.raises(ConfigurationError) as error:
        load(tmp_path, text)
    assert f"emulator.yaml:{line}: " in str(error.value)
    assert part in str(error.value)
    assert "\n" not in str(error.value)


def test_an_effect_is_switched_on_by_its_name_and_off_by_false(tmp_path):
    effects = configured_scenario(load(tmp_path, "effects: {creep: true, friction: false}\n")).effects
    assert effects.creep is not None
    assert effects.friction is None


def test_overrides_leave_their_neighbours_alone(tmp_path):
    scenario = configured_scenario(load(tmp_path, "physics: {load_cell: {white_noise_N: 0.5}}\nscenario: seed_bench\n"))
    assert scenario.load_cell.white_noise_N == 0.5
    assert scenario.stack.irreversible == load_scenario("seed_bench").stack.irreversible


def test_effects_named_beside_the_scenario_keep_the_strengths_given_in_it():
    scenario = load_scenario("stack", {"effects": {"creep": {"per_decade": 0.03}}})
    both = with_effects(scenario, ("creep", "friction")).effects
    assert both.creep is not None
    assert both.creep.per_decade == 0.03
    assert both.friction is not None
    with pytest.raises(ConfigurationError):
        with_effects(scenario, ("crepe",))


def test_a_line_template_matches_its_own_form_only():
    pattern = LineCommand(request="SVA A {voltage_V}").pattern()
    assert pattern.fullmatch("SVA A 12.5").group("voltage_V") == "12.5"
    assert pattern.fullmatch("SVA B 12.5") is None
    assert pattern.fullmatch("SVA A 12.5 3") is None
