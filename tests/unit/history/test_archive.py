"""Archives: which recordings are diagnosed, in which order, with which model, and which benches stand out."""

import json
import zlib
from pathlib import Path

import pytest

from piezod.errors import ConfigurationError, UsageError
from piezod.history.archive import find_benches, in_numbers, is_archive
from piezod.history.archive_run import BenchRun
from piezod.history.fleet import Fleet
from piezod.model import file_sha256, load_model, save_model
from piezod.model.parameters import EffectValues
from piezod.report.fleet import fleet_text, write_fleet_pages
from piezod.tasks.task import Outcome

SHIPPED = Path(__file__).parents[3] / "config" / "model.yaml"
FINDINGS = {"verdict": "matches", "words": "nothing is missing"}


def write_recording(path, date=None, force=1.0):
    head = "" if date is None else f"# recorded: {date}\n"
    path.write_text(f"{head}time_s,voltage_V,force_N\n0.0,0.0,0.0\n0.001,1.0,{force}\n")


def write_bench(archive, name="bench", recordings=("work_1.csv", "work_2.csv"), dates=None):
    folder = archive / name
    folder.mkdir(parents=True)
    save_model(load_model(SHIPPED), folder / "model.yaml")
    for number, recording in enumerate(recordings):
        write_recording(folder / recording, dates and dates[number], force=float(number))
    return folder


def outcome(run, model=None, failed=None):
    """Outcome of the next task of a run, as its worker writes it; with another model, or that of the task."""
    files = {name: zlib.decompress(content) for name, content in run.task().files.items()}
    stated = json.loads(files["task.json"])
    ran = {"recording": stated["recording_sha256"], "given": stated["given_sha256"], "cpu_s": 1.0, "failed": failed}
    written = {"run.json": json.dumps(ran).encode()}
    if failed is None:
        written |= {"findings.json": json.dumps(FINDINGS).encode(), "model.yaml": model or files["model.yaml"]}
    return Outcome("bench", written, failed)


def with_creep(path, per_decade, error=1e-4):
    effect = EffectValues(
        name="creep",
        parameters={"per_decade": per_decade, "from_s": 0.1, "to_s": 1000.0, "slope": 0.0, "driven_by": 0.0},
        intervals={"per_decade": (per_decade - error, per_decade + error)},
    )
    save_model(load_model(SHIPPED).model_copy(update={"effects": (effect,)}), path)
    return path.read_bytes()


def test_numbers_in_names_count_as_numbers():
    assert sorted(["week_10.csv", "week_9.csv", "b.csv"], key=in_numbers) == ["b.csv", "week_9.csv", "week_10.csv"]


def test_recordings_follow_their_dates_where_all_state_one_else_their_names(tmp_path):
    names = ("work_2.csv", "work_10.csv", "work_1.csv")
    write_bench(tmp_path, "dated", names, ("2026-03-01T08:00:00", "2026-02-01", "2026-02-28T23:30:00-02:00"))
    write_bench(tmp_path, "named", names, ("2026-03-01", "2026-02-01", None))
    dated, named = find_benches([tmp_path])
    assert [one.path.name for one in dated.recordings] == ["work_10.csv", "work_1.csv", "work_2.csv"]
    assert [one.path.name for one in named.recordings] == ["work_1.csv", "work_2.csv", "work_10.csv"]


def test_a_folder_of_models_or_the_output_of_a_diagnosis_is_no_archive(tmp_path):
    folder = write_bench(tmp_path / "archive")
    assert is_archive(tmp_path / "archive")
    assert not is_archive(folder)  # a bench, as before: its models are read
    (folder / "findings.json").write_text("{}")
    assert not is_archive(tmp_path / "archive")
    with pytest.raises(ConfigurationError, match="holds no folder with"):
        find_benches([tmp_path / "archive"])


def test_files_without_the_columns_of_the_model_make_no_archive(tmp_path):
    folder = write_bench(tmp_path, recordings=())
    (folder / "figure.csv").write_text("date,value\n1,2\n")
    assert not is_archive(tmp_path)


def test_two_benches_of_one_name_are_refused(tmp_path):
    write_bench(tmp_path / "a")
    write_bench(tmp_path / "b")
    with pytest.raises(UsageError, match="two benches have one name"):
        find_benches([tmp_path / "a", tmp_path / "b"])


def test_each_recording_gets_the_model_that_the_recording_before_it_gave(tmp_path):
    write_bench(tmp_path)
    run = BenchRun(find_benches([tmp_path])[0], tmp_path / "out")
    grown = with_creep(tmp_path / "grown.yaml", 0.02)
    run.save(outcome(run, model=grown))
    assert zlib.decompress(run.task().files["model.yaml"]) == grown
    run.save(outcome(run))
    assert run.next is None
    assert [path.parent.name for path in run.model_paths] == ["bench", "work_1.csv"]  # the second one is the same


def test_a_later_run_continues_behind_what_is_diagnosed(tmp_path):
    folder = write_bench(tmp_path, recordings=("work_1.csv", "work_2.csv", "work_3.csv"))
    first = BenchRun(find_benches([tmp_path])[0], tmp_path / "out")
    first.save(outcome(first, model=with_creep(tmp_path / "grown.yaml", 0.02)))
    first.save(outcome(first))
    later = BenchRun(find_benches([tmp_path])[0], tmp_path / "out")
    assert (later.remaining, later.next.path.name) == (1, "work_3.csv")
    assert file_sha256(later.model_path) == file_sha256(tmp_path / "grown.yaml")
    write_recording(folder / "work_2.csv", force=9.0)  # what changes is diagnosed again
    assert BenchRun(find_benches([tmp_path])[0], tmp_path / "out").next.path.name == "work_2.csv"


def test_a_damaged_recording_is_passed_over_and_a_dead_process_is_tried_again(tmp_path):
    write_bench(tmp_path)
    run = BenchRun(find_benches([tmp_path])[0], tmp_path / "out")
    damaged = run.save(outcome(run, failed="work_1.csv: is empty"))
    assert damaged.failed == "work_1.csv: is empty"
    assert run.save(Outcome("bench", {}, "its process ended with -9")).failed == "its process ended with -9"
    assert run.next is None
    later = BenchRun(find_benches([tmp_path])[0], tmp_path / "out")
    assert later.next.path.name == "work_2.csv"
    assert later.done[0].failed == "work_1.csv: is empty"


@pytest.fixture
def fleet(tmp_path):
    """Six benches with creep of 1.9 to 2.1 % per decade, and one with 6 %."""
    runs = []
    for number, per_decade in enumerate((0.019, 0.0195, 0.02, 0.02, 0.0205, 0.021, 0.06), 1):
        name = f"bench_{number}"
        write_bench(tmp_path / "archive", name, ("work_1.csv",))
        (bench,) = [one for one in find_benches([tmp_path / "archive"]) if one.name == name]
        run = BenchRun(bench, tmp_path / "out" / name)
        run.save(outcome(run, model=with_creep(tmp_path / f"{name}.yaml", per_decade)))
        runs.append(run)
    return Fleet.of(runs)


def test_the_bench_whose_creep_is_far_from_the_others_stands_out(fleet):
    (line,) = fleet.stands_out
    assert line == "bench_7: creep of the stack is 6.000 % per decade, the median is 2.000 % per decade"


def test_the_fleet_has_a_table_and_a_page_beside_that_of_each_bench(fleet, tmp_path):
    lines = fleet_text(fleet).splitlines()
    assert lines[-2].startswith("7 recordings of 7 benches; benches that changed: 7; what stands out: 1")
    assert "* 6.000 %" in lines[7]
    write_fleet_pages(tmp_path / "out", fleet)
    page = (tmp_path / "out" / "fleet.html").read_text()
    assert "bench_7/history.html" in page
    assert "work_1.csv" in (tmp_path / "out" / "bench_7" / "history.html").read_text()


def test_fewer_than_five_benches_have_no_spread(fleet):
    assert Fleet(fleet.benches[3:]).stands_out == []
