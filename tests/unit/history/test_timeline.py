"""The models of a bench are ordered by lineage and date, compared with their parents, and summed up in words."""

import csv
import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest
import yaml

import piezod
from piezod.errors import ConfigurationError, ModelError
from piezod.history.words import between
from piezod.model import file_sha256, load_model, model_sha256, save_model
from piezod.model.parameters import EffectValues, ModelChange, RecordingSource
from piezod.report.history import write_history_csv, write_history_page

SHIPPED = Path(__file__).parents[3] / "config" / "model.yaml"


def creep(per_decade, error):
    return EffectValues(
        name="creep",
        parameters={"per_decade": per_decade, "from_s": 0.1, "to_s": 1000.0, "slope": 0.0, "driven_by": 0.0},
        intervals={"per_decade": (per_decade - error, per_decade + error)},
    )


def save(path, day, effects=(), parent=None, changes=(), recorded=None):
    """A model of a day in March, with the file of its parent."""
    model = load_model(SHIPPED)
    source = RecordingSource(path="work.csv", sha256="0" * 64, samples=100, span_s=20.0, date=recorded)
    provenance = model.provenance.model_copy(
        update={
            "created": f"2026-03-{day:02}T09:00:00+00:00",
            "parent": None if parent is None else file_sha256(parent),
            "diagnosed": () if recorded is None else (source,),
            "changes": tuple(ModelChange(name=name, status=status, words="") for name, status in changes),
        }
    )
    save_model(model.model_copy(update={"effects": tuple(effects), "provenance": provenance}), path)
    return path


@pytest.fixture
def lineage(tmp_path):
    """Identified on 5 March, creep found on 12 March, grown on 19 March."""
    first = save(tmp_path / "z.yaml", 5)
    second = save(tmp_path / "b.yaml", 12, [creep(0.013, 5e-4)], first, [("creep", "new"), ("base", "kept")])
    grown = [("creep", "changed"), ("base", "kept")]
    third = save(tmp_path / "a.yaml", 19, [creep(0.021, 5e-4)], second, grown)
    return first, second, third


def test_the_hash_of_a_model_is_that_of_the_file_it_is_saved_as(tmp_path):
    path = save(tmp_path / "model.yaml", 5, [creep(0.013, 5e-4)])
    assert model_sha256(load_model(path)) == file_sha256(path)


def test_models_are_ordered_by_date_and_the_verdict_dates_each_change(lineage, tmp_path):
    found = piezod.history(tmp_path)
    assert [step.entry.paths[0] for step in found.timeline.steps] == list(lineage)
    assert found.verdict == (
        "creep of the stack appeared (1.30 % per decade) between 5 and 12 March; "
        "creep of the stack grew from 1.30 to 2.10 % per decade between 12 and 19 March; all else kept"
    )


def test_a_parent_stands_before_its_child_even_if_its_clock_was_ahead(tmp_path):
    parent = save(tmp_path / "parent.yaml", 20)
    child = save(tmp_path / "child.yaml", 10, parent=parent)
    assert [step.entry.paths[0] for step in piezod.history([child, parent]).timeline.steps] == [parent, child]


def test_a_changed_stack_is_dated_by_the_recording_of_its_new_base(tmp_path):
    path = save(tmp_path / "model.yaml", 20, recorded="2026-03-05T09:00:00")
    model = load_model(path)
    base = RecordingSource(path="new.csv", sha256="1" * 64, samples=100, span_s=20.0, date="2026-03-14T09:00:00")
    provenance = model.provenance.model_copy(update={"recordings": (base,)})
    save_model(model.model_copy(update={"provenance": provenance}), path)
    assert piezod.history(path).timeline.steps[0].entry.date == datetime(2026, 3, 14, 9, tzinfo=UTC)


def test_the_date_of_the_newest_recording_comes_before_that_of_the_model(tmp_path):
    path = save(tmp_path / "model.yaml", 20, recorded="2026-03-18T23:30:00-02:00")
    assert piezod.history(path).timeline.steps[0].entry.date == datetime(2026, 3, 19, 1, 30, tzinfo=UTC)


def test_a_model_is_compared_with_its_parent_and_not_with_the_model_before(lineage, tmp_path):
    sibling = save(tmp_path / "c.yaml", 21, [creep(0.013, 5e-4)], lineage[1], [("creep", "kept"), ("base", "kept")])
    step = piezod.history(tmp_path).timeline.steps[-1]
    assert step.entry.paths == (sibling,)
    assert step.reference.paths == (lineage[1],)
    assert [change.status for change in step.changes] == ["kept", "kept"]


def test_copies_of_a_model_are_one_model(lineage, tmp_path):
    (tmp_path / "folder").mkdir()
    shutil.copy(lineage[1], tmp_path / "folder" / "model.yaml")
    steps = piezod.history(tmp_path).timeline.steps
    assert [len(step.entry.paths) for step in steps] == [1, 2, 1]


def test_a_commented_copy_of_a_parent_is_still_the_parent(lineage):
    lineage[1].write_text("# in use since May\n" + lineage[1].read_text(encoding="utf-8"), encoding="utf-8")
    again = save(lineage[1].with_name("d.yaml"), 25, [creep(0.013, 5e-4)], lineage[1], [("creep", "kept")])
    assert piezod.history([lineage[1], again]).timeline.steps[1].reference.paths == (lineage[1],)


def test_an_older_file_without_lineage_is_read_and_the_notes_say_so(lineage, tmp_path):
    older = save(tmp_path / "old.yaml", 26, [creep(0.03, 5e-4)])
    step = piezod.history([*lineage, older]).timeline.steps[-1]
    assert "states no parent, as in files of older versions; compared with the model before it" in step.notes
    assert {change.name: change.status for change in step.changes} == {"base": "kept", "creep": "changed"}


def test_a_parent_that_is_not_given_is_named_in_a_note(lineage):
    (step,) = piezod.history(lineage[2]).timeline.steps
    assert any(note.startswith(f"its parent, SHA-256 {file_sha256(lineage[1])[:12]}") for note in step.notes)


def test_one_model_has_nothing_to_be_compared_with(lineage):
    assert piezod.history(lineage[0]).verdict == "one model, nothing to compare it with"


def test_models_without_a_change_are_summed_up(tmp_path):
    first = save(tmp_path / "a.yaml", 5, [creep(0.013, 5e-4)])
    save(tmp_path / "b.yaml", 28, [creep(0.013, 5e-4)], first, [("creep", "kept"), ("base", "kept")])
    assert piezod.history(tmp_path).verdict == "nothing changed in 2 models between 5 and 28 March; all parameters kept"


def test_other_files_of_a_folder_are_passed_over(lineage, tmp_path):
    (tmp_path / "bench.yaml").write_text("schema: piezod.bench/1\n", encoding="utf-8")
    (tmp_path / "findings.json").write_text("{}", encoding="utf-8")
    assert len(piezod.history(tmp_path).timeline.steps) == 3


def test_a_missing_file_an_empty_folder_and_a_broken_model_are_one_line(lineage, tmp_path):
    with pytest.raises(ConfigurationError, match=r"nothing\.yaml: cannot be read"):
        piezod.history(tmp_path / "nothing.yaml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigurationError, match="empty: holds no model file, nor do its subfolders"):
        piezod.history(tmp_path / "empty")
    content = yaml.safe_load(lineage[0].read_text(encoding="utf-8"))
    content["provenance"]["parent"] = "abc"
    lineage[0].write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"z\.yaml.*provenance\.parent is 'abc'") as caught:
        piezod.history(tmp_path)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 78
    lineage[0].write_text("schema: piezod.model/0\n", encoding="utf-8")
    with pytest.raises(ModelError, match=r"must be 'piezod\.model/1'"):
        piezod.history(lineage[0])


def test_the_table_marks_what_has_changed_and_the_csv_has_a_row_for_each_model(lineage, tmp_path):
    found = piezod.history(tmp_path)
    rows = str(found).splitlines()
    assert ["* 1.30 %" in row for row in rows[:4]] == [False, False, True, False]
    assert ["* 2.10 %" in row for row in rows[:4]] == [False, False, False, True]
    write_history_csv(tmp_path / "history.csv", found.timeline)
    with (tmp_path / "history.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [row["creep.per_decade"] for row in table] == ["", "0.013", "0.021"]
    assert [row["creep.per_decade_changed"] for row in table] == ["", "1", "1"]
    assert [row["creep.per_decade_low"] for row in table[1:]] == ["0.0125", "0.0205"]
    assert [row["base.gain_changed"] for row in table] == ["0", "0", "0"]
    assert [row["parent"] for row in table] == ["", *(file_sha256(path) for path in lineage[:2])]


def test_the_page_has_a_panel_for_each_parameter_and_the_verdict(lineage, tmp_path):
    found = piezod.history(tmp_path)
    write_history_page(tmp_path / "history.html", found.timeline)
    page = (tmp_path / "history.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == len(found.timeline.keys) == 5
    assert "Creep of the stack appeared (1.30 % per decade) between 5 and 12 March" in page


def test_the_json_states_each_model_with_its_changes(lineage, tmp_path):
    content = json.loads(json.dumps(piezod.history(tmp_path).as_dict()))
    assert content["schema"] == "piezod.history/1"
    grown = content["models"][2]
    assert grown["parent"] == file_sha256(lineage[1])
    assert grown["compared_with"] == str(lineage[1])
    assert grown["parameters"]["creep.per_decade"]["changed"]
    assert [(change["name"], change["status"]) for change in grown["changes"]] == [
        ("base", "kept"),
        ("creep", "changed"),
    ]


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ("2026-03-12T09:00", "2026-03-19T10:00", "between 12 and 19 March"),
        ("2026-03-30T09:00", "2026-04-02T10:00", "between 30 March and 2 April"),
        ("2025-12-30T09:00", "2026-01-02T10:00", "between 30 December 2025 and 2 January 2026"),
        ("2026-03-12T09:14", "2026-03-12T11:30", "between 09:14 and 11:30 on 12 March"),
        ("2026-03-12T09:14:01", "2026-03-12T09:14:30", "at 09:14 on 12 March"),
    ],
)
def test_a_period_is_as_short_as_it_is_unambiguous(first, second, words):
    dates = [datetime.fromisoformat(text).replace(tzinfo=UTC) for text in (first, second)]
    assert between(*dates) == words
