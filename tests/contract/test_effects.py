"""What the catalogue promises of every effect, each promise one test over all of them."""

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
from piezod.effects import EFFECTS, Context, Seat
from piezod.recording.hold import HELD_BEFORE, STRAIGHT, Hold

HELD = Hold("held", 1e-9)  # read at once after its command

CATALOGUE = {
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
FIELDS = ["Forward", "Inverse", "Signature", "Seat", "Valid", "Source"]
TAKES_ITS_OWN_COURSE = {"gain_drift", "load_step", "vibration", "mains_hum"}
SHIFTS_A_CONSTANT = {"voltage_clamp", "output_nonlinearity", "contact_gap", "quantisation", "noncongruent_minor_loops"}
LOOKS_AHEAD = {  # a faster clock; and what is measured by the range of the whole record
    "clock_skew": lambda values: values["skew_ppm"] > 0.0,
    "creep": lambda values: values["driven_by"] == 1.0,
    "rate_dependent_hysteresis": lambda values: values["kind"] == 2.0,
    "noncongruent_minor_loops": lambda values: True,
}
MIDDLE = {  # neither so weak nor so fast that nothing could be seen on a grid of 0.25 ms to 4 ms
    "voltage_clamp": {"limit_V": 70.0, "knee_V": 5.0},
    "slew_limit": {"limit_V_per_s": 150.0},
    "electrical_lag": {"time_constant_s": 0.05},
    "rate_dependent_hysteresis": {"growth": 0.1, "rate_way_V": 8.0},
    "contact_gap": {"gap_N": 20.0, "softness_N": 10.0},
    "resonance": {"frequency_Hz": 8.0, "damping_ratio": 0.1},
    "load_step": {"on_s": 0.512, "off_s": 1.024, "rise_s": 0.128},
    "charge_leakage": {"time_constant_s": 1.0},
    "sensor_filter": {"cutoff_Hz": 3.0},
    "feedthrough": {"rise_s": 0.05},
    "transport_delay": {"delay_s": 0.0305},
    "clock_skew": {"skew_ppm": -10_000.0},
    "sensor_dropout": {"from_s": 0.512, "to_s": 0.768},
    "vibration": {"breathing_depth": 0.5},
    "noncongruent_minor_loops": dict.fromkeys(
        [f"degree_{d}_{j}" for d in (1, 3, 4, 5) for j in range(4)] + ["curve_3", "curve_4", "curve_5"], 0.0
    ),
    "mains_hum": {"sine_2": 0.3, "cosine_3": 0.2, "sine_5": 0.1},
}
every_effect = pytest.mark.parametrize("name", list(EFFECTS))


def of_form(form):
    return pytest.mark.parametrize("name", [one.name for one in EFFECTS.values() if one.form == form])


def middle(name):
    return {one.name: one.starts[0] for one in EFFECTS[name].parameters} | MIDDLE.get(name, {})


def ends(name, seed=1, most=48):
    """The corners of the box of all parameters; a seeded choice where there are many."""
    sides = [one.choices or (one.low, one.high) for one in EFFECTS[name].parameters]
    sizes = [len(side) for side in sides]
    count = math.prod(sizes)
    places = range(count) if count <= most else np.random.default_rng(seed).integers(count, size=most)
    corners = [[side[k] for side, k in zip(sides, np.unravel_index(n, sizes), strict=True)] for n in places]
    names = [one.name for one in EFFECTS[name].parameters]
    return [middle(name), *(dict(zip(names, corner, strict=True)) for corner in corners)]


def smooth(t):
    return 60.0 + 40.0 * np.sin(2.1 * t - 0.4) + 15.0 * np.sin(9.0 * t + 1.0)


def context_of(dt_s=1e-3, duration_s=2.048, **changed):
    t = np.arange(round(duration_s / dt_s)) * dt_s
    u = smooth(t)
    temperature = 21.0 + 0.5 * np.sin(1.7 * t)
    made = Context(dt_s, t, u, u, duration_s, force_span_N=100.0, temperature_C=temperature)
    return replace(made, **changed)


def wandering(size, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(size=size))
    return 5.0 + 100.0 * (x - x.min()) / np.ptp(x) + rng.normal(scale=0.1, size=size)


def results(name, signal, context, values):
    """All arrays that an effect makes of a signal."""
    effect = EFFECTS[name]
    wider = () if effect.widening is None else effect.widening(context, values)
    return [effect.forward(signal, context, values), *wider]


def sources():
    return sorted(Path(piezod.effects.__file__).parent.glob("*.py"))


def test_names_and_parameters_are_those_of_the_catalogue():
    found = {one.name: [parameter.name for parameter in one.catalogued] for one in EFFECTS.values()}
    assert found == CATALOGUE


def test_effects_stand_in_the_order_of_the_signal_chain():
    seats = [one.seat for one in EFFECTS.values()]
    assert seats == sorted(seats)
    assert set(seats) == set(Seat)


def test_every_effect_has_a_file_of_its_own_that_imports_no_other():
    assert {path.stem for path in sources()} == set(EFFECTS) | {"__init__", "effect", "kernels"}
    for path in sources():
        if path.stem not in EFFECTS:
            continue
        tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        imported = {node.module for node in tree if isinstance(node, ast.ImportFrom) and node.module}
        own = {module for module in imported if module.startswith("piezod")}
        assert not {module for module in own if module.startswith("piezod.effects.")} - {
            "piezod.effects.effect",
            "piezod.effects.kernels",
        }


def test_no_compiled_step_calls_one_of_another_file_so_no_cache_outlives_an_edit():
    for path in sources():
        module = import_module(f"piezod.effects.{path.stem}")
        compiled = [one.py_func for one in vars(module).values() if isinstance(one, CPUDispatcher)]
        for step in (one for one in compiled if one.__module__ == module.__name__):
            called = (step.__globals__.get(name) for name in step.__code__.co_names)
            foreign = [one for one in called if isinstance(one, CPUDispatcher) and one.__module__ != module.__name__]
            assert not foreign, step


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
    signature = text.split("Signature ")[1].split(" Seat ")[0]
    assert any(other in signature for other in [*set(CATALOGUE) - {name}, "the plays"])


@every_effect
def test_what_is_not_compensated_says_why_and_all_say_what_would_tell_them_apart(name):
    effect = EFFECTS[name]
    assert bool(effect.why) == (effect.handling != "compensated")
    assert effect.separate_by
    assert effect.title


@every_effect
def test_a_search_has_somewhere_to_begin(name):
    for one in EFFECTS[name].parameters:
        assert 1 <= len(one.starts) <= 4
        assert not one.choices or set(one.starts) <= set(one.choices)


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_rest_stays_rest(name, hold):
    level = np.full(500, 37.0)
    nothing = 0.0 * level
    context = context_of(duration_s=0.5, applied_V=level, command_V=level, temperature_C=level, hold=hold)
    for values in ends(name):
        if name == "gain_drift":
            assert not results(name, nothing, context, values)[0].any()
        elif name not in TAKES_ITS_OWN_COURSE:
            for result in results(name, level, context, values):
                np.testing.assert_allclose(result, result[0], rtol=1e-12)
            if name not in SHIFTS_A_CONSTANT:
                np.testing.assert_allclose(results(name, level, context, values)[0], level, rtol=1e-12)


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_everything_is_finite_over_random_signals_at_the_ends_of_all_ranges(name, hold):
    u = wandering(600, seed=2)
    context = context_of(duration_s=0.6, applied_V=u, command_V=u, hold=hold)
    for values in ends(name):
        for result in results(name, wandering(600, seed=3), context, values):
            assert result.shape == u.shape
            assert np.isfinite(result).all(), values


@every_effect
def test_a_signal_is_left_as_it_was_and_gives_the_same_again(name):
    context, signal = context_of(), wandering(2048, seed=4)
    before = signal.copy()
    once, again = (results(name, signal, context, middle(name)) for _ in range(2))
    assert np.array_equal(signal, before)
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))


@of_form("linear")
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_linear_effects_pass_a_sum_as_the_sum_of_its_parts(name, hold):
    context = context_of(hold=hold)
    x, y = wandering(2048, seed=5), wandering(2048, seed=6)
    for values in ends(name):
        of_x, of_y, of_both = (EFFECTS[name].forward(one, context, values) for one in (x, y, 2.0 * x - 0.7 * y))
        np.testing.assert_allclose(of_both, 2.0 * of_x - 0.7 * of_y, atol=1e-8)


@of_form("additive")
def test_what_an_additive_effect_adds_does_not_depend_on_the_signal(name):
    context = context_of()
    x, y = wandering(2048, seed=7), wandering(2048, seed=8)
    for values in ends(name):
        added = (EFFECTS[name].forward(one, context, values) - one for one in (x, y))
        np.testing.assert_allclose(*added, atol=1e-9, rtol=1e-9)


@of_form("memoryless")
def test_a_memoryless_effect_looks_at_the_present_sample_alone(name):
    context, x = context_of(), wandering(2048, seed=9)
    order = np.random.default_rng(10).permutation(x.size)
    for values in ends(name):
        forward = EFFECTS[name].forward
        assert np.array_equal(forward(x[order], context, values), forward(x, context, values)[order])


@every_effect
@pytest.mark.parametrize("hold", [STRAIGHT, HELD, HELD_BEFORE])
def test_what_is_to_come_changes_nothing_before(name, hold):
    now = 900
    x, u = wandering(2048, seed=11), wandering(2048, seed=12)
    context = context_of(applied_V=u, command_V=u, hold=hold)
    later_x, later_u, later_T = x.copy(), u.copy(), context.temperature_C.copy()
    later_x[now:], later_u[now:], later_T[now:] = 3.0, 90.0, 40.0
    later = replace(context, applied_V=later_u, command_V=later_u, temperature_C=later_T)
    for values in ends(name):
        if name in LOOKS_AHEAD and LOOKS_AHEAD[name](values):
            continue
        for one, other in zip(results(name, x, context, values), results(name, later_x, later, values), strict=True):
            assert np.array_equal(one[:now], other[:now])


@every_effect
def test_a_finer_grid_gives_the_same_to_second_order(name):
    def on_grid(finer):
        context = context_of(dt_s=4e-3 / finer)
        return [one[::finer] for one in results(name, smooth(context.time_s), context, middle(name))]

    for coarse, fine, finest in zip(on_grid(1), on_grid(4), on_grid(64), strict=True):
        error, of_a_quarter = np.abs(coarse - finest).max(), np.abs(fine - finest).max()
        assert of_a_quarter <= max(error / 8.0, 1e-9 * np.abs(finest).max())  # second order gives 16, first order 4
