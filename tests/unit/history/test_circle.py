"""A bench is identified, creeps, and creeps twice as much: the history of its models says so."""

import pytest

import piezod
from piezod.model import file_sha256
from tests.benches.plain_stack import record, triangles, work


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the models of three generations."""
    folder = tmp_path_factory.mktemp("bench")
    piezod.identify(str(record(folder / "before.csv", triangles([100, 40, 80, 60, 100, 30, 90]), 1))).model.save(
        folder / "model_0.yaml"
    )
    for generation, per_decade in ((1, 0.013), (2, 0.026)):
        recording = record(
            folder / f"work_{generation}.csv", work(2 + generation, 20.0), 5, creep_per_decade=per_decade
        )
        found = piezod.diagnose(str(recording), folder / f"model_{generation - 1}.yaml")
        found.model.save(folder / f"model_{generation}.yaml")
    return folder


def test_each_model_names_its_parent_and_every_recording_with_a_part_in_it(bench):
    for generation in (1, 2):
        provenance = piezod.Model.load(bench / f"model_{generation}.yaml").provenance
        assert provenance.parent == file_sha256(bench / f"model_{generation - 1}.yaml")
        files = [bench / "before.csv", *(bench / f"work_{k}.csv" for k in range(1, generation + 1))]
        entries = (*provenance.recordings, *provenance.diagnosed)
        assert [entry.sha256 for entry in entries] == [file_sha256(path) for path in files]
        assert entries[-1].span_s == pytest.approx(20.0, abs=0.01)


def test_the_history_says_that_creep_appeared_and_grew(bench):
    found = piezod.history(bench)
    assert [
        [(change.name, change.status) for change in step.changes if change.status != "kept"]
        for step in found.timeline.steps
    ] == [[], [("creep", "new")], [("creep", "changed")]]
    assert found.verdict.startswith("creep of the stack appeared (1.")
    assert "creep of the stack grew from 1." in found.verdict
    assert found.verdict.endswith("; all else kept")
