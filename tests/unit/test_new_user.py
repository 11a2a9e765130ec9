"""The day of a new user: each command has its time and exit code, and the day its table."""

import sys

import pytest

from tests.studies.new_user import Day, run, table


def test_each_command_is_printed_with_its_time_and_exit_code(tmp_path, capsys):
    day = Day(tmp_path, [sys.executable, "-c", "import sys; print('out'); sys.exit(len(sys.argv) - 1)"])
    day.begin("Chapter")
    assert day.piezod("identify", "a b.csv") == "out\n"
    assert [(chapter, shown, code) for chapter, shown, _, code in day.steps] == [
        ("Chapter", "piezod identify 'a b.csv'", 2)
    ]
    printed = capsys.readouterr().out
    assert "## Chapter" in printed
    assert "$ piezod identify 'a b.csv'\n  out\n" in printed
    assert ", exit 2]" in printed


def test_the_table_sums_the_times_of_each_chapter(tmp_path):
    day = Day(tmp_path, [], steps=[("one", "a", 1.0, 0), ("two", "b", 2.5, 0), ("one", "c", 4.0, 0)])
    lines = [line.split() for line in table(day).splitlines()]
    assert lines[2:] == [["one", "2", "5.0"], ["two", "1", "2.5"], ["whole", "day", "3", "7.5"]]


@pytest.mark.slow
def test_a_whole_day_ends_with_a_history(tmp_path):
    day = run(tmp_path)
    failed = [(shown, code) for chapter, shown, _, code in day.steps if code and chapter != "Demo"]
    assert failed == []
    assert "creep" in (tmp_path / "models" / "diagnosis_1" / "findings.json").read_text(encoding="utf-8")
