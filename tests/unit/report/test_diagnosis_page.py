"""The page of a diagnosis: what its first screen says, its figures' numbers, and that it needs nothing but itself."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bokeh.models import BoxAnnotation

from piezod.diagnose.diagnosis import Diagnosis
from piezod.diagnose.findings import Finding, Findings, HeldOut, Place, Rival, Value
from piezod.diagnose.series import Series
from piezod.model import load_model
from piezod.report.diagnosis.figures import driver_figure, time_lines
from piezod.report.diagnosis.page import write_diagnosis_page
from piezod.report.diagnosis.residual_views import Residuals, memory, owners, since_reversal, views
from piezod.report.diagnosis.spectra import spectrum, time_frequency
from piezod.report.figures.thinning import envelope, envelope_times, extremes

MODEL = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
DT_S = 0.002
LIMIT_BYTES = 3_000_000

DELAY = Finding(
    name="transport_delay",
    title="transport delay",
    confidence=0.97,
    scope="already",
    where=(),
    parameters={"delay_s": Value(0.0098831, "s", 0.009802, 0.009964)},
    before=1.976,
    after=0.48,
    rivals=(Rival("sensor_filter", 0.12, "the phase of a chirp"), Rival("resonance", 3.0, "the phase of a chirp")),
    handling="compensated",
)
STEP = Finding(
    name="load_step",
    title="step of the load",
    confidence=0.75,
    scope="once",
    where=(Place("time_s", 4.0, 6.0),),
    parameters={"step_N": Value(3.0, "N", 2.9, 3.1)},
    before=0.9,
    after=0.48,
    handling="refused",
    why="nobody knows when it comes",
)
FROZEN = Finding(
    name="sensor_dropout",
    title="frozen reading",
    confidence=0.97,
    scope="once",
    where=(Place("time_s", 2.0, 2.1),),
    parameters={"from_s": Value(2.0, "s", 2.0, 2.0), "to_s": Value(2.1, "s", 2.1, 2.1)},
    before=2.82,
    after=2.82,
    handling="corrected in the reading",
    why="nothing was read there",
)
REFITTED = 1.9  # N
WHERE = (
    Place("rate_V_per_s", 100.0, 200.0, 0.75, 0.01),
    Place("time_s", 4.0, 6.0, 0.3, 0.01),
    Place("frequency_Hz", 50.0, 50.0, 0.2, 0.02),
    Place("direction", -1.0, 1.0, 0.1, 0.02),
)


def series(name, role="recording", seconds=12.0, temperature=None, start_s=0.0, seed=1):
    time_s = np.arange(round(seconds / DT_S)) * DT_S
    u = 60.0 + 60.0 * np.sin(2 * np.pi * 0.5 * time_s)
    noise = np.random.default_rng(seed).normal(0.0, 0.1, u.size)
    counts = np.ones(u.size, bool)
    counts[1000:1050] = False
    kelvin = None if temperature is None else temperature + 0.1 * time_s
    return Series(name, role, time_s, u, 2.0 * u + noise, counts, 0.1, temperature_C=kelvin, start_s=start_s)


def diagnosis(effects=(DELAY, STEP, FROZEN), verdict="explained", recordings=None, notes=(), where=WHERE):
    made = [series("identification.csv", "identification"), *(recordings or [series("work.csv")])]
    findings = Findings(
        verdict=verdict,
        words="",
        unit="N",
        floor=0.447,
        floor_from="quiet",
        where=where,
        effects=effects,
        before=2.82,
        after=0.48 if effects else 2.82,
        nrmse_before=97.0,
        nrmse_after=99.5,
        explainable=0.6 if "un" in verdict or "partly" in verdict else 0.001,
        notes=notes,
        refitted=None if effects else 0.48 if verdict == "matches" else REFITTED,
        recordings=tuple({"path": one.name, "sha256": "ab" * 32, "samples": one.time_s.size} for one in made),
    )
    base = [one.reading_N + np.roll(one.command_V, 5) - one.command_V for one in made]
    extended = [2.0 * one.command_V for one in made]
    return Diagnosis(findings, MODEL, made, base, extended)


def written(folder, *args, **kwargs):
    write_diagnosis_page(folder / "report.html", diagnosis(*args, **kwargs))
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("page")
    written(made)
    return made


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def first_screen(page):
    """Text in front of the first section below it."""
    body = page[page.index("<header>") : page.index("<h2>")]
    return " ".join(re.sub("<[^>]*>", " ", body).replace("\N{NO-BREAK SPACE}", " ").split())


def columns(path):
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_first_screen_says_what_where_and_how_sure(page):
    said = first_screen(page)
    assert "Left out by the model: transport delay, step of the load and frozen reading" in said
    assert "explained" in said
    assert "2.82 N → 0.480 N; noise floor 0.447 N" in said
    assert "acquisition transport delay frozen reading" in said  # the signal chain
    assert "mechanics step of the load" in said
    assert "delay 9.88 ms 9.80 to 9.96" in said
    assert "97 % sure" in said
    assert "or low-pass of the load cell" in said  # nearer than the noise tells
    assert "75 % likely" in said
    assert "1.98 → 0.480 N noise 0.447" in said
    assert "read off the data, no fit" in said
    assert "already there when the model was identified" in said
    assert "happened once, in one recording" in said
    assert "cannot be compensated" in said
    assert "rate of the command 100 to 200 V/s (75 %)" in said


def test_the_page_is_small_and_loads_nothing_from_elsewhere(tmp_path):
    page = written(tmp_path, recordings=[series(f"work {k}.csv", seconds=60.0, seed=k) for k in range(5)])
    assert len(page.encode()) < LIMIT_BYTES
    outside = re.sub("(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
    assert "//" not in outside.replace("<!DOCTYPE", "")
    assert not {"<link", "@import", "src="} & set(re.findall("<link|@import|src=", outside))
    assert "default-src 'none'" in outside  # and a browser would refuse


def test_every_figure_has_its_numbers_beside_it_and_links_to_them(page, folder):
    links = set(re.findall(r"href='(figures/[^']*)'", page))
    files = {f"figures/{path.name}" for path in (folder / "figures").iterdir()}
    assert links | {"figures/effects.csv", "figures/places.csv"} == files
    assert page.count("<!--") == 0  # every figure stands in its place
    assert columns(folder / "figures" / "time_1.csv").keys() == {
        "time_s",
        "measured",
        "given",
        "extended",
        "before",
        "after",
    }


def test_each_effect_has_its_equation_rivals_and_the_experiment(page):
    cards = page[page.index("<h2>The effects</h2>") : page.index("<h2>Before and after</h2>")]
    assert cards.count("<article") == 3
    assert "y(t) = F(t - delay)" in cards
    assert "0.12 noises" in cards
    assert "the phase of a chirp" in cards
    assert "nobody knows when it comes" in cards


def test_what_remains_is_said_plainly(tmp_path):
    page = written(tmp_path, notes=("work.csv: samples are not evenly spaced",))
    remains = page[page.index("<h2>What remains unexplained</h2>") :]
    assert "0.480 N rms are left" in remains
    assert "less than 1 % of what is left: nothing else is worth a name" in remains
    assert "Transport delay might be low-pass of the load cell: in these" in remains
    assert "Step of the load: cannot be compensated: nobody knows when it comes." in remains
    assert "samples are not evenly spaced" in remains
    assert "ab" * 32 in remains


def test_a_model_that_matches_has_a_page_without_effects(tmp_path):
    page = written(tmp_path, effects=(), verdict="matches", where=())
    said = first_screen(page)
    assert "The model matches the recordings: nothing is missing" in said
    assert "No place in time" in said
    assert "refitted model" in page
    assert "<h2>The effects</h2>" not in page


def test_something_unexplained_is_said_with_its_places_and_what_a_flexible_model_reaches(tmp_path):
    page = written(tmp_path, effects=(), verdict="unexplained")
    said = first_screen(page)
    assert "Something is missing that no known effect explains" in said
    assert "Error on data left out: 2.82 N, 1.90 N once refitted" in said
    assert "60 % of what is left: there is something" in said
    assert "frequency 50.00 Hz 20 % 0.02" in said
    rows = (tmp_path / "figures" / "held_out_error.csv").read_text().splitlines()
    assert f"a flexible model without physics,{REFITTED * 0.4**0.5:.9g}" in rows


@pytest.mark.parametrize("verdict", ["partly_explained", "not_testable"])
def test_every_other_verdict_has_its_title(tmp_path, verdict):
    effects = (DELAY,) if verdict == "partly_explained" else ()
    said = first_screen(written(tmp_path, effects=effects, verdict=verdict))
    assert {"partly_explained": "and something unknown besides", "not_testable": "cannot tell"}[verdict] in said


def test_a_temperature_channel_gets_a_figure_of_its_own(tmp_path):
    written(tmp_path, recordings=[series("work.csv", temperature=20.0)])
    kelvin = columns(tmp_path / "figures" / "left_over_temperature_C.csv")["temperature_C"]
    assert kelvin.min() >= 20.0
    assert kelvin.max() <= 21.2


def test_several_recordings_have_curves_of_their_own_and_times_name_theirs(tmp_path):
    quiet, loud = series("one.csv", seed=1), series("two.csv", seed=2)
    made = diagnosis(recordings=[quiet, loud])
    made.base[2][2000:3000] += 50.0
    write_diagnosis_page(tmp_path / "report.html", made)
    said = first_screen((tmp_path / "report.html").read_text())
    assert "time 4.0 to 6.0 s of two.csv" in said
    for number in (1, 2):
        for name in ("time", "loop", "map", "spectrum", "left_over_time_s"):
            assert (tmp_path / "figures" / f"{name}_{number}.csv").is_file()


def test_only_the_recordings_with_the_largest_errors_are_drawn(tmp_path):
    page = written(tmp_path, recordings=[series(f"work {k}.csv", seed=k) for k in range(5)])
    assert "2 more are in the tables" in page
    assert len(list((tmp_path / "figures").glob("time_*.csv"))) == 3


def test_names_of_recordings_are_text_and_not_markup(tmp_path):
    page = written(tmp_path, recordings=[series("</script><b>.csv"), series("two.csv")])
    assert "<b>.csv" not in page


def test_a_thinned_curve_keeps_every_spike():
    values = np.zeros(100_000)
    values[31_415], values[77_777] = 5.0, -3.0
    thin = envelope(values, 1000)
    assert thin.size <= 1002
    assert (thin.max(), thin.min()) == (5.0, -3.0)
    times = envelope_times(np.arange(100_000.0), 1000)
    assert times.size == thin.size
    assert abs(times[thin.argmax()] - 31_415) <= 200
    assert {31_415, 77_777} <= set(extremes(values, 1000))


def test_a_thinned_curve_keeps_gaps_and_short_curves_as_they_are():
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    thin = envelope(values, 100)
    assert np.isnan(thin[20:40]).all()
    assert np.isfinite(thin[:20]).all()
    short = np.array([1.0, np.nan, 2.0])
    assert envelope(short, 10) is short


def test_since_a_reversal_counts_from_its_extreme():
    u = np.concatenate((np.linspace(0, 10, 11), np.linspace(9, 2, 8), np.linspace(3, 6, 4)))
    since, level = since_reversal(u)
    np.testing.assert_array_equal(since[10:19], [10, 1, 2, 3, 4, 5, 6, 7, 8])
    assert (level[12], level[20]) == (10.0, 2.0)
    np.testing.assert_array_equal(since[19:], [1, 2, 3, 4])


def test_binned_means_tell_rising_from_falling():
    one = series("work.csv")
    lag = np.sign(np.cos(2 * np.pi * 0.5 * one.time_s))
    left = Residuals(replace(one, reading_N=2.0 * one.command_V + lag), 2.0 * one.command_V, 2.0 * one.command_V + lag)
    view = next(view for view in views([left], [(1, left)], ("V", "N")) if view.name == "voltage_V")
    np.testing.assert_allclose(view.before.rising[1:-1], 1.0, atol=0.05)
    np.testing.assert_allclose(view.before.falling[1:-1], -1.0, atol=0.05)
    np.testing.assert_allclose(view.after.mean, 0.0, atol=1e-12)


def test_memory_is_seen_at_its_age():
    rng = np.random.default_rng(5)
    one = series("work.csv", seconds=60.0)
    u = np.repeat(rng.uniform(0, 100, one.time_s.size // 10), 10)
    faded = np.empty(u.size)
    state, keep = 0.0, np.exp(-DT_S / 0.5)
    for k, value in enumerate(u):
        state = value + keep * (state - value)
        faded[k] = state
    left = Residuals(replace(one, command_V=u, reading_N=faded, counts=np.ones(u.size, bool)), 0.0 * u, faded)
    found = memory([left])
    assert 0.25 < found.at_s[np.abs(found.before).argmax()] < 1.5
    assert np.abs(found.after).max() < 1e-6


def test_white_noise_as_large_as_the_floor_is_at_zero_decibels():
    noise = np.random.default_rng(3).normal(0.0, 0.2, 60_000)
    level_dB = time_frequency(noise, DT_S, 0.2).level_dB
    assert 10.0 * np.log10(np.mean(10.0 ** (level_dB / 10.0))) == pytest.approx(0.0, abs=0.3)
    frequency_Hz, density = spectrum(noise, DT_S)
    assert np.sqrt(np.trapezoid(density**2, frequency_Hz)) == pytest.approx(0.2, rel=0.03)


def test_a_tone_stands_out_at_its_time_and_frequency():
    time_s = np.arange(60_000) * DT_S
    tone = np.where((time_s > 30.0) & (time_s < 60.0), np.sin(2 * np.pi * 50.0 * time_s), 0.0)
    found = time_frequency(tone + np.random.default_rng(3).normal(0.0, 0.1, tone.size), DT_S, 0.1)
    row, column = np.unravel_index(found.level_dB.argmax(), found.level_dB.shape)
    assert found.frequency_Hz[row] <= 50.0 <= found.frequency_Hz[row + 1]
    assert 30.0 < found.time_s[column] < 60.0


def test_a_place_in_time_belongs_to_the_recording_with_most_left_there():
    one, two = (Residuals(s, s.reading_N.copy(), s.reading_N) for s in (series("one.csv"), series("two.csv")))
    two.given[2000:3000] += 5.0
    place = Place("time_s", 4.0, 6.0)
    assert owners([place, WHERE[0]], [one, two]) == {place: two}


def test_an_uncertain_effect_is_not_stated_as_a_fact_in_the_title(tmp_path):
    said = first_screen(written(tmp_path, effects=(replace(DELAY, confidence=0.45), STEP)))
    assert "Left out by the model: perhaps transport delay and step of the load" in said


def test_recordings_held_out_and_effects_that_could_not_be_seen_are_said(tmp_path):
    made = diagnosis()
    held = HeldOut("/data/later.csv", "ab" * 32, 3.21, 0.456)
    findings = replace(made.findings, held_out=(held,), not_testable=("creep", "friction"))
    write_diagnosis_page(tmp_path / "report.html", replace(made, findings=findings))
    page = " ".join(re.sub("<[^>]*>", " ", (tmp_path / "report.html").read_text()).split())
    assert "later.csv, held out: nothing was fitted to it 3.21 0.456" in page
    assert "Nothing is said about creep of the stack and friction in the guide" in page


def test_units_are_those_of_the_recording_and_not_of_the_catalogue(tmp_path):
    made = diagnosis(effects=(STEP,))
    model = made.model.model_copy(update={"output": made.model.output.model_copy(update={"unit": "um"})})
    findings = replace(made.findings, unit="um")
    write_diagnosis_page(tmp_path / "report.html", replace(made, findings=findings, model=model))
    said = first_screen((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "step 3.00 \N{MICRO SIGN}m 2.90 to 3.10" in said
    assert "2.82 \N{MICRO SIGN}m → 0.480 \N{MICRO SIGN}m" in said


def test_one_wild_sample_does_not_flatten_the_residual():
    one = series("work.csv")
    spike = one.reading_N.copy()
    spike[500] += 1000.0
    left = Residuals(replace(one, reading_N=spike), one.reading_N, one.reading_N + 0.1)
    rest = time_lines(left, 1000, [], ("V", "N"), "extended model")[0][1]
    assert -5.0 < rest.y_range.start < -0.1
    assert 0.0 < rest.y_range.end < 5.0


def test_a_place_wider_than_the_data_does_not_squeeze_the_curves():
    one = series("work.csv")
    left = Residuals(one, 1.9 * one.command_V, 2.0 * one.command_V)
    view = next(view for view in views([left], [(1, left)], ("V", "N")) if view.name == "rate_V_per_s")
    plot = driver_figure(view, [Place("rate_V_per_s", 50.0, 1e5)], "N", "extended model")[0][0]
    boxes = [box for box in plot.select(BoxAnnotation) if box.hatch_pattern]
    assert boxes
    assert max(abs(edge) for box in boxes for edge in (box.left, box.right)) <= np.abs(view.at).max()
