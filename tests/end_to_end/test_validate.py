"""Models compared on the emulated bench, in its own time."""

import json

import pytest

from piezod.model import dump_model, load_model, save_model
from piezod.model.reach import output_reach
from tests.benches.emulator import ROOT, bench_file, emulator, piezod

REFERENCES = 6
RATE_HZ = 100.0  # ticks of virtual time take time too


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """The shipped model with two of its plays left, their weights scaled so that its chord stays."""
    model = load_model(ROOT / "config" / "model.yaml")
    plays = model.hysteresis.plays
    kept = [0, 3]
    scale = sum(plays.weights) / sum(plays.weights[k] for k in kept)
    fewer = plays.model_copy(
        update={
            "thresholds": tuple(plays.thresholds[k] for k in kept),
            "weights": tuple(scale * plays.weights[k] for k in kept),
        }
    )
    hysteresis = model.hysteresis.model_copy(update={"plays": fewer})
    reduced = model.model_copy(update={"hysteresis": hysteresis})
    high = output_reach(reduced)[1]  # a bench is driven by no model whose forces go far beyond those measured
    reduced = reduced.model_copy(update={"output": model.output.model_copy(update={"high": high})})
    path = tmp_path_factory.mktemp("models") / "coarse.yaml"
    save_model(reduced, path)
    assert dump_model(load_model(path)) == dump_model(reduced)
    return path


@pytest.fixture(scope="module")
def validated(coarse, tmp_path_factory):
    """Figures and page of the shipped model beside the coarse one."""
    folder = tmp_path_factory.mktemp("validate")
    page = folder / "validation.html"
    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(folder, serves, rate_Hz=RATE_HZ, limits={"stale_after_ms": 40})
        models = ("--model", coarse, "--model", ROOT / "config" / "model.yaml")
        done = piezod("validate", bench, *models, "--report", page, "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout), page.read_text(encoding="utf-8")


def test_the_better_model_is_named(validated):
    result, _ = validated
    assert result["better"] == "model"
    assert result["words"].startswith("model is the better model")
    assert result["next_step"]["bench_lines"] == [f"model: {ROOT / 'config' / 'model.yaml'}"]
    means = result["mean_max_hysteresis_percent"]
    assert means["model"] < means["coarse"] < means["without"]


def test_a_good_model_leaves_less_than_a_quarter_of_the_hysteresis_on_every_reference(validated):
    result, _ = validated
    opening = {(one["reference"], one["compensation"]): one["max_hysteresis_percent"] for one in result["figures"]}
    references = {key[0] for key in opening}
    assert len(references) == REFERENCES
    for reference in references:
        assert opening[reference, "model"] < 0.25 * opening[reference, "without"]


def test_the_references_are_six_slow_triangles_within_what_both_models_reach(validated):
    result, _ = validated
    low_N, high_N = result["range_N"]
    chosen = {(one["amplitude_N"], one["offset_N"]) for one in result["figures"]}
    assert len({amplitude_N for amplitude_N, _ in chosen}) == 3
    assert len({offset_N for _, offset_N in chosen}) == 2
    for amplitude_N, offset_N in chosen:
        assert low_N < offset_N - amplitude_N
        assert offset_N + amplitude_N < high_N
    assert all(one["frequency_Hz"] == 0.1 for one in result["figures"])
    assert all(one["samples"] > 3 * 10 * RATE_HZ - 10 for one in result["figures"])


def test_the_page_shows_every_reference(validated):
    result, page = validated
    assert "Validation: error and max hysteresis with each model" in page
    for one in result["figures"]:
        assert one["reference"] in page


def test_a_run_that_trips_gives_no_verdict(coarse, tmp_path):
    with emulator("--time", "virtual", "--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=RATE_HZ, limits={"stale_after_ms": 40, "force_trip_N": 250.0})
        done = piezod("validate", bench, "--model", coarse)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "FAULT after 0 of 12 runs: force above limits.force_trip_N" in done.stdout


@pytest.mark.parametrize(
    ("models", "code", "says"),
    [
        (["coarse", "coarse"], 2, "stands twice"),
        (["missing"], 78, "missing.yaml"),
        (["coarse", "elsewhere"], 78, "give models of the same bench"),
    ],
)
def test_models_that_cannot_be_compared_are_refused_in_one_line(models, code, says, coarse, tmp_path):
    model = load_model(coarse)
    elsewhere = tmp_path / "elsewhere.yaml"
    hysteresis = model.hysteresis.model_copy(update={"offset": 1000.0})
    output = model.output.model_copy(update={"low": model.output.low + 1000.0, "high": model.output.high + 1000.0})
    save_model(model.model_copy(update={"hysteresis": hysteresis, "output": output}), elsewhere)
    files = {"coarse": coarse, "missing": tmp_path / "missing.yaml", "elsewhere": elsewhere}
    arguments = [text for name in models for text in ("--model", files[name])]
    done = piezod("validate", ROOT / "config" / "bench.yaml", *arguments)
    assert done.returncode == code
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr
