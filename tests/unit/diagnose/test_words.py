"""One wording of values, places and effects."""

from dataclasses import replace

import pytest

from piezod.diagnose.findings import Base, Finding, Findings, Place, UnchangedEffect, Value
from piezod.diagnose.verdict import words
from piezod.diagnose.verdict.verdict import words_of
from piezod.effects import EFFECTS

RANGE = EFFECTS["transport_delay"].parameter("delay_s")
WORDING = words.Wording("V", "N")
FLEXURE = words.Wording("V", "um")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (Value(0.0098831, "s", 0.009802, 0.009964), ("9.88\N{NO-BREAK SPACE}ms", "9.80 to 9.96")),
        (Value(0.25, "s", 0.25, 0.25), ("0.2500\N{NO-BREAK SPACE}s", "")),
        (Value(0.15, "s", RANGE.low, RANGE.high), ("0.150\N{NO-BREAK SPACE}s", "not determined by these recordings")),
        (Value(0.2, "s", 0.05, 0.4), ("0.200\N{NO-BREAK SPACE}s", "0.0500 to 0.400")),
    ],
)
def test_a_value_has_as_many_digits_as_its_interval_bears(value, said):
    assert words.value_words(value, "delay_s", "transport_delay") == said


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (Place("frequency_Hz", 50.0, 50.0), "frequency 50.00 Hz"),
        (Place("frequency_Hz", 0.4123, 250.0), "frequency 0.412 to 250 Hz"),
        (Place("time_s", 53.81, 57.83), "time 53.8 to 57.8 s"),
        (Place("direction", -1.0, 1.0), "rising and falling differ"),
    ],
)
def test_a_place_is_said_in_words(place, said):
    assert words.place_words(place, WORDING) == said


@pytest.mark.parametrize(
    ("number", "said"), [(0.0, "0"), (2.8213, "2.82"), (11.649, "11.6"), (1234.5, "1234"), (0.00012345, "1.23e-04")]
)
def test_numbers_keep_three_digits(number, said):
    assert words.rounded(number) == said


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (Place("force_N", -115.56, -112.34), "output -115.6 to -112.3 \N{MICRO SIGN}m"),
        (Place("amplitude_V", 0.0, 0.082417), "way since the last reversal 0 to 0.082 V"),
        (Place("rate_V_per_s", 565.97, 15794.5), "rate of the command 566 to 15800 V/s"),
    ],
)
def test_a_place_is_in_units_of_the_recording_with_no_more_digits_than_it_bears(place, said):
    assert words.place_words(place, FLEXURE) == said


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("N", "\N{MICRO SIGN}m"),
        ("N s/V", "\N{MICRO SIGN}m s/V"),
        ("N/K", "\N{MICRO SIGN}m/K"),
        ("V/s", "V/s"),
        ("Hz", "Hz"),
        ("ppm", "ppm"),
        ("s", "s"),
    ],
)
def test_units_of_the_catalogue_become_those_of_the_recording(unit, said):
    assert FLEXURE.unit(unit) == said


CREEP = Finding(
    name="creep",
    title="creep of the stack",
    confidence=0.9,
    scope="since",
    where=(Place("history_s", 0.1604, 30.0),),
    parameters={"per_decade": Value(0.0127, "1", 0.0123, 0.0130), "from_s": Value(0.16, "s", 0.1, 0.2)},
    before=1.0,
    after=0.1,
)


def test_an_effect_is_said_in_one_clause():
    assert words.effect_words(CREEP) == (
        "creep of the stack, 1.270 % per decade (1.230 to 1.300), seen at memory 0.160 to 30.0 s"
    )
    everywhere = replace(
        CREEP, name="transport_delay", title="transport delay", where=(), parameters={"delay_s": DELAY}
    )
    assert words.effect_words(everywhere) == "transport delay, delay 9.88 ms (9.80 to 9.96)"


DELAY = Value(0.0098831, "s", 0.009802, 0.009964)


def test_a_share_is_said_in_per_cent():
    curvature = Value(-0.48998, "1", -0.492, -0.4879)
    assert words.value_words(curvature, "curvature", "output_nonlinearity") == (
        "-49.00\N{NO-BREAK SPACE}%",
        "-49.20 to -48.79",
    )


@pytest.mark.parametrize(
    ("size", "half", "said"),
    [
        (28.145109, 3e-6, ("28.15\N{NO-BREAK SPACE}Hz", "")),
        (2.5e-7, 1e-8, ("2.50e-07\N{NO-BREAK SPACE}Hz", "2.40e-07 to 2.60e-07")),
    ],
)
def test_an_interval_whose_ends_are_said_alike_is_not_said(size, half, said):
    told = words.value_words(Value(size, "Hz", size - half, size + half), "frequency_Hz", "vibration", WORDING)
    assert told == said


@pytest.mark.parametrize(
    ("titles", "said"), [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (list("abc"), "a, b and c")]
)
def test_names_are_joined_by_commas_and_a_last_and(titles, said):
    assert words.listed(titles) == said


def test_ends_that_hardly_differ_are_one_except_in_time():
    assert words.place_words(Place("rate_V_per_s", 27.9998, 28.0, 0.1, 0.01)) == "rate of the command 28.00 V/s"
    assert words.place_words(Place("time_s", 27.9998, 28.0, 0.1, 0.01)) == "time 27.99980 to 28.00000 s"


@pytest.mark.parametrize(
    ("verdict", "explainable", "after", "said"),
    [
        ("matches", 0.0, 0.11, "nothing is missing"),
        ("matches", 0.0, 0.25, "what is left is more than noise, and nothing tells what it is"),
        ("explained", 0.05, 0.25, "what is left is more than noise, and nothing tells what it is"),
        ("explained", 0.05, 0.11, "nothing else is left"),
        ("explained", 0.4, 0.11, "40 % of what is left is no noise"),
        ("unexplained", 0.4, 0.25, "40 % of what is left is no noise"),
    ],
)
def test_nobody_is_told_that_nothing_is_left_while_far_more_than_noise_is(verdict, explainable, after, said):
    findings = Findings(verdict, "", "N", 0.1, "quiet", (), (), 2.0, after, 90.0, 99.0, explainable)
    assert words_of(findings, WORDING).endswith(f"error 2 -> {after:.3g} N, noise 0.1 N; {said}")


def test_a_floor_of_nothing_is_said_too():
    findings = Findings("matches", "", "N", 0.0, "spectrum", (), (), 2.0, 1.0, 90.0, 99.0, 0.0)
    assert words_of(findings, WORDING).endswith("what is left is more than noise, and nothing tells what it is")


def test_the_error_of_the_given_model_stays_alone_where_no_other_model_is_written():
    findings = Findings("matches", "", "N", 0.1, "quiet", (), (), 0.12, 0.12, 90.0, 90.0, 0.0, refitted=0.11)
    assert "error 0.12 N, noise 0.1 N; nothing is missing" in words_of(findings, WORDING)
    refitted = replace(findings, before=0.2, after=0.11)
    assert "error 0.2 -> 0.11 N with hysteresis and sampling refitted, noise 0.1 N" in words_of(refitted, WORDING)


def changed(name, now, was, status="changed"):
    """Finding of an effect of the given model, its first parameter in the interval of 10 %."""
    parameter = next(iter(EFFECTS[name].parameters))
    values = [Value(one, parameter.unit, 0.9 * one, 1.1 * one) for one in (now, was)]
    title = EFFECTS[name].title
    return Finding(
        name,
        title,
        0.99,
        "since",
        (),
        {parameter.name: values[0]},
        2.0,
        0.1,
        status=status,
        was={parameter.name: values[1]},
    )


def test_a_change_is_told_from_and_to_and_what_is_kept_beside_it():
    effects = changed("creep", 0.021, 0.013), changed("transport_delay", 0.0, 0.0015, "gone")
    kept = UnchangedEffect("electrical_lag", {}, seen=True), UnchangedEffect("resonance", {}, seen=False)
    findings = Findings("explained", "", "N", 0.1, "quiet", (), effects, 2.0, 0.1, 90.0, 99.0, 0.0, kept=kept)
    said = words_of(findings, WORDING)
    assert "creep of the stack grew from 1.30 % per decade (1.17 to 1.43) to 2.10 % per decade (1.89 to 2.31)" in said
    assert "transport delay is gone, was 1.50 ms (1.35 to 1.65)" in said
    assert f"{EFFECTS['electrical_lag'].title} kept; {EFFECTS['resonance'].title} not seen" in said


def test_a_change_of_the_stack_is_told_in_per_cent():
    base = Base(True, gain=Value(0.969, "1", 0.967, 0.971))
    findings = Findings("explained", "", "N", 0.1, "quiet", (), (), 2.0, 0.1, 90.0, 99.0, 0.0, base=base)
    assert words_of(findings, WORDING).startswith(
        "the stack itself has changed: gain -3.1 % (-3.3 to -2.9), loops as before; error 2 -> 0.1 N"
    )
