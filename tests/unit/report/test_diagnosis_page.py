"""The page of a diagnosis: its first screen, the data of its figures, and no external resources."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.findings import HeldOut
from piezod.diagnose.verdict.words import effect_words
from piezod.report.diagnosis.page import write_diagnosis_page
from tests.unit.report.example_diagnosis import DELAY, REFITTED, STEP, diagnosis, series

LIMIT_BYTES = 3_000_000


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


def test_the_first_screen_has_effects_places_and_confidence(page):
    screen = first_screen(page)
    assert "Missing in the model: transport delay, step of the load and frozen reading" in screen
    assert "explained" in screen
    assert "2.82 N → 0.480 N; noise floor 0.447 N" in screen
    assert "acquisition transport delay frozen reading" in screen  # the signal chain
    assert "mechanics step of the load" in screen
    assert "delay 9.88 ms 9.80 to 9.96" in screen
    assert "97 % (high)" in screen
    assert "or low-pass of the load cell" in screen  # a rival that the noise hides
    assert "75 % (medium)" in screen
    assert "1.98 → 0.480 N noise 0.447" in screen
    assert "observed directly, not fitted" in screen
    assert "present when the model was identified" in screen
    assert "happened once, in one recording" in screen
    assert "cannot be compensated" in screen
    assert "rate of the command 100 to 200 V/s (75 %)" in screen


def test_the_page_is_small_and_loads_no_external_resource(tmp_path):
    page = written(tmp_path, recordings=[series(f"work {k}.csv", seconds=60.0, seed=k) for k in range(5)])
    assert len(page.encode()) < LIMIT_BYTES
    outside = re.sub("(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
    assert "//" not in outside.replace("<!DOCTYPE", "")
    assert not {"<link", "@import", "src="} & set(re.findall("<link|@import|src=", outside))
    assert "default-src 'none'" in outside  # and a browser would refuse


def test_every_figure_links_to_its_csv_file(page, folder):
    links = set(re.findall(r"href='(figures/[^']*)'", page))
    files = {f"figures/{path.name}" for path in (folder / "figures").iterdir()}
    assert links | {"figures/effects.csv", "figures/places.csv"} == files
    assert page.count("<!--") == 0  # no placeholder remains
    assert columns(folder / "figures" / "time_1.csv").keys() == {
        "time_s",
        "measured",
        "given",
        "extended",
        "before",
        "after",
    }


def test_each_effect_has_its_equation_rivals_and_the_experiment(page):
    cards = page[page.index("<h2>Effects found</h2>") : page.index("<h2>Errors before and after the diagnosis</h2>")]
    assert cards.count("<article") == 3
    assert "y(t) = F(t - delay)" in cards
    assert "difference of the predictions [times the noise]" in cards
    assert "the phase of a chirp" in cards
    assert "nobody knows when it comes" in cards


def test_what_remains_has_a_section_of_its_own(tmp_path):
    page = written(tmp_path, notes=("work.csv: samples are not evenly spaced",))
    remains = page[page.index("<h2>What remains unexplained</h2>") :]
    assert "The remaining error is 0.480 N rms; the noise is 0.447 N." in remains
    assert "could explain less than 1 % of the remaining error: no further effect is missing" in remains
    assert "Transport delay may instead be low-pass of the load cell: in these" in remains
    assert "Step of the load: cannot be compensated: nobody knows when it comes." in remains
    assert "samples are not evenly spaced" in remains
    assert "ab" * 32 in remains


def test_a_model_that_matches_has_a_page_without_effects(tmp_path):
    page = written(tmp_path, effects=(), verdict="matches", where=())
    screen = first_screen(page)
    assert "The model matches the recordings: no effect is missing" in screen
    assert "No place in time" in screen
    assert "refitted model" in page
    assert "<h2>Effects found</h2>" not in page


def test_an_unexplained_error_has_its_places_and_the_error_of_a_flexible_model(tmp_path):
    page = written(tmp_path, effects=(), verdict="unexplained")
    screen = first_screen(page)
    assert "The model lacks an effect that is not in the catalogue" in screen
    assert "Error of the simulation: 2.82 N, 1.90 N after a refit" in screen
    assert (
        "could explain 60 % of the remaining error: an effect is missing, and the catalogue does not contain it"
        in screen
    )
    assert "frequency 50.00 Hz 20 % 0.02" in screen
    rows = (tmp_path / "figures" / "held_out_error.csv").read_text().splitlines()
    assert f"a flexible model without physics,{REFITTED * 0.4**0.5:.9g}" in rows


@pytest.mark.parametrize("verdict", ["partly_explained", "not_testable"])
def test_every_other_verdict_has_its_title(tmp_path, verdict):
    effects = (DELAY,) if verdict == "partly_explained" else ()
    screen = first_screen(written(tmp_path, effects=effects, verdict=verdict))
    assert {"partly_explained": "and an unknown effect", "not_testable": "cannot show what the model lacks"}[
        verdict
    ] in screen


def test_a_temperature_channel_gets_a_figure_of_its_own(tmp_path):
    written(tmp_path, recordings=[series("work.csv", temperature=20.0)])
    kelvin = columns(tmp_path / "figures" / "left_over_temperature_C.csv")["temperature_C"]
    assert kelvin.min() >= 20.0
    assert kelvin.max() <= 21.2


def test_several_recordings_have_curves_of_their_own_and_their_names_at_places_in_time(tmp_path):
    quiet, loud = series("one.csv", seed=1), series("two.csv", seed=2)
    made = diagnosis(recordings=[quiet, loud])
    made.base[2][2000:3000] += 50.0
    write_diagnosis_page(tmp_path / "report.html", made)
    screen = first_screen((tmp_path / "report.html").read_text())
    assert "time 4.0 to 6.0 s of two.csv" in screen
    for number in (1, 2):
        for name in ("time", "loop", "map", "spectrum", "left_over_time_s"):
            assert (tmp_path / "figures" / f"{name}_{number}.csv").is_file()


def test_only_the_recordings_with_the_largest_errors_are_drawn(tmp_path):
    page = written(tmp_path, recordings=[series(f"work {k}.csv", seed=k) for k in range(5)])
    assert "2 more are in the tables" in page
    assert len(list((tmp_path / "figures").glob("time_*.csv"))) == 3


def test_names_of_recordings_are_escaped(tmp_path):
    page = written(tmp_path, recordings=[series("</script><b>.csv"), series("two.csv")])
    assert "<b>.csv" not in page


@pytest.mark.parametrize(("confidence", "title"), [(0.45, "perhaps transport delay"), (0.65, "transport delay")])
def test_the_title_doubts_an_effect_where_the_words_do(tmp_path, confidence, title):
    doubted = replace(DELAY, confidence=confidence)
    screen = first_screen(written(tmp_path, effects=(doubted, STEP)))
    assert f"Missing in the model: {title} and step of the load" in screen
    assert effect_words(doubted).startswith(title)


def test_held_out_recordings_and_effects_that_were_not_tested_are_listed(tmp_path):
    made = diagnosis()
    held = HeldOut("/data/later.csv", "ab" * 32, 3.21, 0.456)
    findings = replace(made.findings, held_out=(held,), not_testable=("creep", "friction"))
    write_diagnosis_page(tmp_path / "report.html", replace(made, findings=findings))
    page = " ".join(re.sub("<[^>]*>", " ", (tmp_path / "report.html").read_text()).split())
    assert "later.csv, held out from the fit 3.21 0.456" in page
    assert "Not tested: creep of the stack and friction in the guide." in page


def test_units_are_those_of_the_recording_and_not_of_the_catalogue(tmp_path):
    made = diagnosis(effects=(STEP,))
    model = made.model.model_copy(update={"output": made.model.output.model_copy(update={"unit": "um"})})
    findings = replace(made.findings, unit="um")
    write_diagnosis_page(tmp_path / "report.html", replace(made, findings=findings, model=model))
    screen = first_screen((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "step 3.00 \N{MICRO SIGN}m 2.90 to 3.10" in screen
    assert "2.82 \N{MICRO SIGN}m → 0.480 \N{MICRO SIGN}m" in screen
