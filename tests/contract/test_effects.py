"""Promises of the catalogue about every effect. Each test checks one promise for all of them.

A new effect needs no change in this file. `Effect.checks` holds its test values and its exceptions.
"""

import ast
import inspect
import math
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

import piezod.effects
from piezod.effects import EFFECTS, Context, Effect, Location, Parameter, Search
from piezod.effects.effect import Checks
from piezod.operators.play import next_state
from piezod.recording.hold import HELD_BEFORE, STRAIGHT, Hold

HELD = Hold("held", 1e-9)  # read at once after its command

CATALOGUE = {  # interface: names in model files and findings; a new effect may be added
    "voltage_clamp": ["limit_V"],
    "slew_limit": ["limit_V_per_s"],
    "electrical_lag": ["time_constant_s"],
    "rate_dependent_hysteresis": ["growth", "reference_V_per_s"],
    "noncongruent_minor_loops": ["share"],
    "creep": ["per_decade", "from_s", "to_s"],
    "gain_drift": ["relative_change"],
    "output_nonlinearity": ["curvature"],
    "contact_gap": ["gap_N"],
    "friction": ["force_N", "presliding_N"],
    "thermal_drift": ["coefficient_N_per_K"],
    "load_step": ["step_N", "on_s", "off_s"],
    "resonance": ["frequency_Hz", "damping_ratio"],
    "vibration": ["amplitude_N", "frequency_Hz"],
    "charge_leakage": ["time_constant_s"],
    "sensor_filter": ["cutoff_Hz"],
    "feedthrough": ["coefficient_N_s_per_V"],
    "mains_hum": ["amplitude_N", "frequency_Hz"],
    "transport_delay": ["delay_s"],
    "clock_skew": ["skew_ppm"],
    "sensor_dropout": ["from_s", "to_s"],
    "quantisation": ["step_N"],
}
UNITS = {"s", "V", "N", "Hz", "rad", "ppm", "V/s", "N/K", "N s/V"}
FIELDS = ["Forward", "Inverse", "Signature", "Location", "Valid", "Source"]
every_effect = pytest.mark.parametrize("name", list(EFFECTS))


def of_form(*forms):
    return pytest.mark.parametrize("name", [one.name for one in EFFECTS.values() if one.form in forms])


def main_values(name):
    return {one.name: one.search.starts[0] for one in EFFECTS[name].parameters} | dict(EFFECTS[name].checks.values)


def values_to_check(name, seed=1, most=48):
    """The main values, then the corners of the box of all parameters; a seeded choice where there are many."""
    sides = [one.search.choices or (one.low, one.high) for one in EFFECTS[name].parameters]
    sizes = [len(side) for side in sides]
    count = math.prod(sizes)
    numbers = range(count) if count <= most else np.random.default_rng(seed).integers(count, size=most)
    corners = [[side[k] for side, k in zip(sides, np.unravel_index(n, sizes), strict=True)] for n in numbers]
    names = [one.name for one in EFFECTS[name].parameters]
    return [main_values(name), *(dict(zip(names, corner, strict=True)) for corner in corners)]


def smooth(t):
    return 60.0 + 40.0 * np.sin(2.1 * t - 0.4) + 15.0 * np.sin(9.0 * t + 1.0)


def context_of(dt_s=1e-3, duration_s=2.048, **changed):
    t = np.arange(round(duration_s / dt_s)) * dt_s
    u = smooth(t)
    temperature = 21.0 + 0.5 * np.sin(1.7 * t)
    made = Context(dt_s, t, u, u, duration_s, force_span_N=100.0, temperature_C=temperature)
    return replace(made, **changed)


def random_walk(size, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(size=size))
    return 5.0 + 100.0 * (x - x.min()) / np.ptp(x) + rng.normal(scale=0.1, size=size)


def results(name, signal, context, values):
    """Output of an effect for a signal, then factor and offset of the thresholds where it changes them."""
    effect = EFFECTS[name]
    thresholds = () if effect.widening is None else effect.widening(context, values)
    return [effect.forward(signal, context, values), *thresholds]


def sources():
    return sorted(Path(piezod.effects.__file__).parent.glob("*.py"))


def test_no_effect_or_parameter_of_the_interface_is_renamed():
    found = {one.name: [parameter.name for parameter in one.catalogued] for one in EFFECTS.values()}
    assert {name: found.get(name) for name in CATALOGUE} == CATALOGUE


def test_the_registry_is_in_the_order_of_the_signal_chain():
    locations = [one.location for one in EFFECTS.values()]
    assert locations == sorted(locations)
    assert set(locations) == set(Location)


def test_every_effect_has_a_file_of_its_own_that_imports_no_other():
    assert {path.stem for path in sources()} == set(EFFECTS) | {"__init__", "effect", "kernels", "parameter", "tick"}
    for path in sources():
        if path.stem not in EFFECTS:
            continue
        tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        imported = {node.module for node in tree if isinstance(node, ast.ImportFrom) and node.module}
        own = {module for module in imported if module.startswith("piezod")}
        assert not {module for module in own if module.startswith("piezod.effects.")} - {
            "piezod.effects.effect",
            "piezod.effects.kernels",
            "piezod.effects.parameter",
            "piezod.effects.tick",
        }


NAMING = {"commissioning/demo_hidden_effects.py"}
"""The demo says which effects it switches on in the emulator."""


def test_no_further_module_names_an_effect():
    package = Path(piezod.__file__).parent
    names = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if path.parent.name != "effects" and _names_an_effect(path)
    }
    assert names == NAMING


def _names_an_effect(path):
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return any(isinstance(node, ast.Constant) and node.value in tuple(EFFECTS) for node in tree)


def test_a_compiled_step_of_another_file_is_the_play_step_and_its_caller_removes_an_outdated_cache():
    for path in sources():
        module = import_module(f"piezod.effects.{path.stem}")
        compiled = [one.py_func for one in vars(module).values() if isinstance(one, CPUDispatcher)]
        for step in (one for one in compiled if one.__module__ == module.__name__):
            called = (step.__globals__.get(name) for name in step.__code__.co_names)
            foreign = {one for one in called if isinstance(one, CPUDispatcher) and one.__module__ != module.__name__}
            assert foreign <= {next_state}, step
            assert not foreign or hasattr(module, "forget_outdated_steps"), step


@every_effect
def test_a_parameter_ends_in_its_unit(name):
    for one in EFFECTS[name].parameters:
        if one.unit == "1":
            assert not any(one.name.endswith(f"_{unit}") for unit in UNITS)
        else:
            assert one.unit in UNITS
            assert one.name.endswith("_" + one.unit.replace("/", "_per_").replace(" ", "_"))


@every_effect
def test_the_docstring_has_a_line_in_words_and_the_six_fields_in_order(name):
    lines = EFFECTS[name].docstring.splitlines()
    assert lines[0].endswith(".")
    assert lines[1] == ""
    assert [line.split()[0] for line in lines[2:] if not line.startswith(" ")] == FIELDS
    assert all(re.match(rf"({'|'.join(FIELDS)}) +\S|           \S", line) for line in lines[2:])
    assert all(line[10] == " " and line[11] != " " for line in lines[2:])
    assert EFFECTS[name].docstring == inspect.getmodule(EFFECTS[name].widening or EFFECTS[name].forward).__doc__


@every_effect
def test_the_signature_names_a_look_alike_of_the_catalogue_or_the_plays(name):
    text = re.sub(r"\s+", " ", EFFECTS[name].docstring)
    signature = text.split("Signature ")[1].split(" Location ")[0]
    assert any(other in signature for other in [*set(CATALOGUE) - {name}, "the plays"])


@every_effect
def test_an_effect_names_its_experiment_and_a_reason_where_it_is_not_compensated(name):
    effect = EFFECTS[name]
    assert bool(effect.why) == (effect.handling != "compensated")
    assert effect.separate_by
    assert effect.title


@every_effect
def test_a_compensated_effect_has_a_tick_or_a_preview_and_a_refused_one_has_neither(name):
    effect = EFFECTS[name]
    if effect.handling != "corrected in the reading":
        assert (effect.handling == "compensated") == bool(effect.tick or effect.preview)


@every_effect
def test_a_search_has_one_to_four_starts(name):
    for one in EFFECTS[name].parameters:
        assert 1 <= len(one.search.starts) <= 4
        assert not one.search.choices or set(one.search.starts) <= set(one.search.choices)


@every_effect
def test_test_values_are_parameters_within_their_range(name):
    for key, value in EFFECTS[name].checks.values.items():
        parameter = EFFECTS[name].parameter(key)
        assert parameter.low <= value <= parameter.high


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_rest_stays_rest(name, hold):
    level = np.full(500, 37.0)
    nothing = 0.0 * level
    context = context_of(duration_s=0.5, applied_V=level, command_V=level, temperature_C=level, hold=hold)
    expected = EFFECTS[name].checks.constant
    for values in values_to_check(name):
        if expected == "varies":
            if EFFECTS[name].form in ("linear", "scaling"):
                assert not results(name, nothing, context, values)[0].any()
            continue
        for result in results(name, level, context, values):
            np.testing.assert_allclose(result, result[0], rtol=1e-12)
        if expected == "unchanged":
            np.testing.assert_allclose(results(name, level, context, values)[0], level, rtol=1e-12)


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_everything_is_finite_over_random_signals_at_the_ends_of_all_ranges(name, hold):
    u = random_walk(600, seed=2)
    context = context_of(duration_s=0.6, applied_V=u, command_V=u, hold=hold)
    for values in values_to_check(name):
        for result in results(name, random_walk(600, seed=3), context, values):
            assert result.shape == u.shape
            assert np.isfinite(result).all(), values


@every_effect
def test_a_signal_is_left_as_it_was_and_gives_the_same_again(name):
    context, signal = context_of(), random_walk(2048, seed=4)
    before = signal.copy()
    once, again = (results(name, signal, context, main_values(name)) for _ in range(2))
    assert np.array_equal(signal, before)
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))


@of_form("linear", "scaling")
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_linear_effects_pass_a_sum_as_the_sum_of_its_parts(name, hold):
    context = replace(context_of(hold=hold), stroke_per_V=0.0)  # what the voltage adds is no part of the signal
    x, y = random_walk(2048, seed=5), random_walk(2048, seed=6)
    for values in values_to_check(name):
        of_x, of_y, of_both = (EFFECTS[name].forward(one, context, values) for one in (x, y, 2.0 * x - 0.7 * y))
        np.testing.assert_allclose(of_both, 2.0 * of_x - 0.7 * of_y, atol=1e-8)


@of_form("scaling")
def test_what_a_scaling_effect_multiplies_by_does_not_depend_on_the_signal(name):
    context, x = context_of(), random_walk(2048, seed=7)
    for values in values_to_check(name):
        factor = EFFECTS[name].forward(np.ones(x.size), context, values)
        np.testing.assert_allclose(EFFECTS[name].forward(x, context, values), factor * x, rtol=1e-12)


@of_form("additive")
def test_what_an_additive_effect_adds_does_not_depend_on_the_signal(name):
    context = context_of()
    x, y = random_walk(2048, seed=7), random_walk(2048, seed=8)
    for values in values_to_check(name):
        added = (EFFECTS[name].forward(one, context, values) - one for one in (x, y))
        np.testing.assert_allclose(*added, atol=1e-9, rtol=1e-9)


@of_form("memoryless")
def test_a_memoryless_effect_looks_at_the_present_sample_alone(name):
    context, x = context_of(), random_walk(2048, seed=9)
    order = np.random.default_rng(10).permutation(x.size)
    for values in values_to_check(name):
        forward = EFFECTS[name].forward
        assert np.array_equal(forward(x[order], context, values), forward(x, context, values)[order])


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_a_later_input_changes_no_earlier_output(name, hold):
    now = 900
    x, u = random_walk(2048, seed=11), random_walk(2048, seed=12)
    context = context_of(applied_V=u, command_V=u, hold=hold)
    later_x, later_u, later_T = x.copy(), u.copy(), context.temperature_C.copy()
    later_x[now:], later_u[now:], later_T[now:] = 3.0, 90.0, 40.0
    later = replace(context, applied_V=later_u, command_V=later_u, temperature_C=later_T)
    for values in values_to_check(name):
        if EFFECTS[name].checks.anticipates(values):
            continue
        for one, other in zip(results(name, x, context, values), results(name, later_x, later, values), strict=True):
            assert np.array_equal(one[:now], other[:now])


@every_effect
def test_a_finer_grid_gives_the_same_to_second_order(name):
    def on_grid(finer):
        context = context_of(dt_s=4e-3 / finer)
        return [one[::finer] for one in results(name, smooth(context.time_s), context, main_values(name))]

    for coarse, fine, finest in zip(on_grid(1), on_grid(4), on_grid(64), strict=True):
        error, of_a_quarter = np.abs(coarse - finest).max(), np.abs(fine - finest).max()
        assert of_a_quarter <= max(error / 8.0, 1e-9 * np.abs(finest).max())  # second order gives 16, first order 4


def toy(forward):
    """A new effect: one record, its file being this module."""
    gain = Parameter("gain", "1", 0.5, 2.0, Search((1.5,)))
    return Effect("toy", "toy", Location.MECHANICS, "memoryless", (gain,), forward, "refused", "", why="a test")


def test_a_new_effect_is_checked_through_its_record_alone(monkeypatch):
    def scaled_about_its_start(signal, context, values):  # a `Forward`
        return signal[0] + values["gain"] * (signal - signal[0])

    monkeypatch.setitem(EFFECTS, "toy", toy(scaled_about_its_start))
    test_rest_stays_rest("toy", STRAIGHT)
    test_a_later_input_changes_no_earlier_output("toy", STRAIGHT)
    with pytest.raises(AssertionError):  # it declares no memory, and remembers its first sample
        test_a_memoryless_effect_looks_at_the_present_sample_alone("toy")


def test_a_new_effect_that_moves_a_signal_at_rest_must_declare_it(monkeypatch):
    def scaled(signal, context, values):  # a `Forward`
        return values["gain"] * signal

    monkeypatch.setitem(EFFECTS, "toy", toy(scaled))
    with pytest.raises(AssertionError):
        test_rest_stays_rest("toy", STRAIGHT)
    monkeypatch.setitem(EFFECTS, "toy", replace(toy(scaled), checks=Checks(constant="shifted")))
    test_rest_stays_rest("toy", STRAIGHT)
