"""Learning in the daemon: passes from rows, the file of a correction, and what it belongs to."""

from pathlib import Path

import numpy as np
import pytest

from piezod.config import load_bench
from piezod.config.reference import WaveformReference
from piezod.config.sections import LearningConfig
from piezod.control import ROW_DTYPE, State
from piezod.control.references.repeat_correction import RepeatCorrection, correction_cells
from piezod.daemon.learning_watch import LearningWatch
from piezod.errors import ConfigurationError
from piezod.model import load_model
from piezod.recording import read_csv
from piezod.session.assembly import reference_table
from piezod.session.learned_file import LearnedFile, learned_file

CONFIG = Path(__file__).parents[3] / "config"
RATE_HZ, FIRST = 100.0, 30
REFERENCE = {"kind": "triangle", "amplitude_N": 100.0, "offset_N": 150.0, "frequency_Hz": 0.5}


class Bench:
    """Rows of a bench whose force is `gain` times the planned force, and a watch over them."""

    def __init__(self, folder, logged, gain=0.95, model=None, **reference):
        shipped = load_bench(CONFIG / "bench.yaml")
        self.bench = shipped.model_copy(
            update={
                "rate_Hz": RATE_HZ,
                "model": str(model or CONFIG / "model.yaml"),
                "reference": WaveformReference(**REFERENCE | reference),
                "learning": LearningConfig(file=str(folder / "{name}.csv")),
            }
        )
        self.table = reference_table(self.bench, folder)
        cells = np.zeros(correction_cells(len(self.table)))
        correction = RepeatCorrection(cells)
        self.table.correct_by(correction)
        if (earlier := LearnedFile(self.bench, folder / "bench.yaml", self.table).read()) is not None:
            correction.offer(earlier)
        model = load_model(Path(self.bench.model))
        path = folder / "bench.yaml"
        self.watch = LearningWatch(
            self.bench, path, model, RepeatCorrection(cells), logged.append, run=lambda work: work()
        )
        self.gain, self.tick = gain, 0

    def run(self, repeats, lost=()):
        """Follow the table; ticks whose number within a repeat is in `lost` have no reading."""
        for _ in range(repeats * len(self.table) // 10):
            rows = np.zeros(10, ROW_DTYPE)
            for row in rows:
                arming = self.tick <= FIRST
                if arming:
                    self.table.start(self.tick)
                row["reference_N"] = self.table.read(self.tick, 0)
                row["state"] = State.ARMING if arming else State.RUNNING
                row["tick"], row["force_N"] = self.tick, getattr(self, "force_N", 0.0)
                row["result"] = int((self.tick - FIRST) % len(self.table) in lost)
                self.force_N = self.gain * self.table.ahead
                self.tick += 1
            self.watch.add(rows)


def test_the_error_of_a_looped_reference_falls_and_is_in_the_status(tmp_path):
    bench = Bench(tmp_path, [])
    assert bench.watch.as_dict()["rms_N"] is None
    bench.run(8)
    state = bench.watch.as_dict()
    assert state["state"] == "learning"
    assert state["passes"] >= 6
    assert state["rms_N"] < 0.05 * state["first_N"]


def test_the_correction_is_kept_and_the_next_run_starts_from_it(tmp_path):
    logged = []
    first = Bench(tmp_path, logged)
    first.run(8)
    kept = read_csv(tmp_path / "emulator.csv")
    assert kept.channel("reference_N") == pytest.approx(first.table.values())
    second = Bench(tmp_path, logged)
    second.run(3)
    assert "starts from" in logged[0]
    assert second.watch.errors_N[0] < 0.05 * first.watch.errors_N[0]


@pytest.mark.parametrize("changed", [{"amplitude_N": 90.0}, {"frequency_Hz": 1.0}, {"model": "other"}])
def test_a_correction_of_another_reference_or_model_is_not_taken(tmp_path, changed):
    Bench(tmp_path, []).run(5)
    if "model" in changed:
        changed = {"model": tmp_path / "other.yaml"}
        text = (CONFIG / "model.yaml").read_text(encoding="utf-8")
        changed["model"].write_text(text + "\n# identified again\n", encoding="utf-8")
    logged = []
    anew = Bench(tmp_path, logged, **changed)
    anew.run(3)
    assert "starts anew" in logged[0]
    assert anew.watch.errors_N[0] > 3.0


def test_a_damaged_file_is_said_and_learning_starts_anew(tmp_path):
    Bench(tmp_path, []).run(5)
    text = (tmp_path / "emulator.csv").read_text(encoding="utf-8")
    (tmp_path / "emulator.csv").write_text(text[: len(text) // 2], encoding="utf-8")
    logged = []
    Bench(tmp_path, logged).run(5)
    assert "starts anew" in logged[0]


@pytest.mark.parametrize("value", ["nan", "1e6"])
def test_a_correction_beyond_its_bound_is_not_taken(tmp_path, value):
    Bench(tmp_path, []).run(5)
    lines = (tmp_path / "emulator.csv").read_text(encoding="utf-8").splitlines()
    lines[-1] = lines[-1].rpartition(",")[0] + "," + value
    (tmp_path / "emulator.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    logged = []
    Bench(tmp_path, logged)
    assert "starts anew" in logged[0]


def test_lost_readings_are_interpolated(tmp_path):
    bench = Bench(tmp_path, [])
    bench.run(8, lost=(17, 18))
    assert bench.watch.as_dict()["rms_N"] < 0.05 * bench.watch.as_dict()["first_N"]


def test_a_pass_with_too_many_lost_readings_teaches_nothing(tmp_path):
    bench = Bench(tmp_path, [])
    bench.run(5, lost=range(50))
    assert bench.watch.passes == 0


def test_a_foreign_file_is_refused_and_stays(tmp_path):
    (tmp_path / "emulator.csv").write_text("my measurements\n", encoding="utf-8")
    bench = Bench(tmp_path, [])
    with pytest.raises(ConfigurationError, match=r"learning\.file: .*was not made by piezod"):
        learned_file(bench.bench).check()
    bench.run(5)
    assert "was not made by piezod" in bench.watch.as_dict()["problem"]
    assert (tmp_path / "emulator.csv").read_text(encoding="utf-8") == "my measurements\n"


def test_a_kept_correction_has_its_mark_and_is_replaced(tmp_path):
    bench = Bench(tmp_path, [])
    bench.run(5)
    assert b"\n# learned: correction of a looped reference\n" in (tmp_path / "emulator.csv").read_bytes()[:4096]
    learned_file(bench.bench).check()
    bench.run(2)
    assert bench.watch.as_dict()["problem"] == ""
