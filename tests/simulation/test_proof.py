"""`piezod check --proof` in virtual time: its steps, a device that fails them, and Ctrl-C in each of them."""

import json
import signal

import pytest

from piezod.commissioning.proof import STEPS, prove
from tests.simulation import amplifier as judged
from tests.simulation.installed import new_process_of_the_daemon
from tests.simulation.machine import SECOND, Process
from tests.simulation.plan import Event, Plan
from tests.simulation.row_history import RowHistory
from tests.simulation.runs import run, warm_up

WITHIN_S = 60.0
AT_ONCE = ("minimum", "temperature", "thermometer", "clamp")  # they end in their first ticks, or are skipped
INTERRUPTED_AFTER_S = 0.05
ARRIVES_WITHIN_S = 0.2  # the signal, by way of the parent


@pytest.fixture(scope="module", autouse=True)
def _warm():
    warm_up()


class ProofHistory(RowHistory):
    """A bench whose service drives the proof test, as `piezod check --proof` does."""

    steps_before, interrupted_in = (), ""

    def start(self, arms=None):
        """Start the proof test in place of `piezod run`."""
        for step in self.steps_before:
            self.steps(json.dumps([step]))
        if self.interrupted_in:
            kept = {name: step for name, step in STEPS.items() if name in ("level", self.interrupted_in)}
            STEPS.clear()
            STEPS.update(kept | {self.interrupted_in: self._interrupted(kept[self.interrupted_in])})
        self.arm_begins()  # and does not end: the output may be driven, its range and its slew are judged
        new_process_of_the_daemon()
        self.service = Process(self.machine, "daemon")
        self.service.start(self._prove)

    def _interrupted(self, step):
        def interrupted(proof):
            if self.interrupted_in in AT_ONCE:
                self.service.signal(signal.SIGINT)
                self.machine.sleep(ARRIVES_WITHIN_S)
            else:
                self.machine.after(round(INTERRUPTED_AFTER_S * SECOND), lambda: self.service.signal(signal.SIGINT))
            return step(proof)

        return interrupted

    def _prove(self):
        path = self.folder / "record.json"
        record, _ = prove(self.path, path)
        self.disk.acknowledged.clear()  # of the recording that the command removes at its end
        self.observed["record"] = record
        self.observed["same"] = json.loads(path.read_text(encoding="utf-8")) == record

    def do_deaf_watchdog(self, _):
        """The watchdog keeps its time in its register and does not act."""
        self.amplifier.device._set_watchdog = lambda _ms: None
        self.amplifier.bench.set_watchdog(0.0, safe_V=0.0, ramp_V_per_s=400.0)

    def trace(self):
        """Without the rates of ramps: some steps withhold commands on purpose."""
        trace = super().trace()
        trace._dt_ns = 0
        return trace

    def _observe_end(self):
        self.amplifier.catch_up()
        self.observed["output_V"] = abs(self.amplifier.bench.output_V)
        self.observed["highest_V"] = float(self.amplifier.judge[judged.HIGHEST])


def proven(steps_before=(), interrupted_in="", events=()):
    """Record of a proof test, with what else was observed; the amplifier is at rest at the end."""
    about = {"steps_before": steps_before, "interrupted_in": interrupted_in}
    result = run(Plan(1, WITHIN_S, events=events), make=type("History", (ProofHistory,), about))
    assert result.violations == []
    assert result.observed["same"]
    assert result.observed["output_V"] <= 0.1
    return result.observed["record"], result.observed


def results_of(record):
    return {step["name"]: step["result"] for step in record["steps"]}


def test_every_step_passes_and_the_record_names_bench_device_version_and_date():
    record, observed = proven()
    assert record["passed"] is record["left_at_rest"] is True
    assert [step["name"] for step in record["steps"]] == list(STEPS)
    assert {name for name, result in results_of(record).items() if result != "pass"} == {"clamp"}  # null in the file
    assert record["coverage"]["proven"] == record["coverage"]["configured"] - 3
    assert all(not reason.startswith("step ") for reason in record["coverage"]["not_proven"].values())
    assert record["identity"] == {"identity": 20570.0, "map_version": 1.0}
    assert {"schema", "bench", "device", "version", "date_utc"} <= set(record)
    done = [step for step in record["steps"] if step["result"] == "pass"]
    assert all(step["measured"] is not None and step["limit"] is not None for step in done)
    assert observed["highest_V"] <= 7.5


def test_a_watchdog_that_is_set_and_does_not_act_fails_and_the_bench_is_left_at_rest():
    record, _ = proven(({"deaf_watchdog": True},))
    results = results_of(record)
    assert results.pop("watchdog") == "fail"
    assert {result for name, result in results.items() if name != "clamp"} == {"pass"}
    assert record["coverage"]["not_proven"]["device_watchdog_ms"] == "step watchdog: fail"
    assert record["left_at_rest"]
    assert not record["passed"]


def test_a_stuck_load_cell_fails_the_first_step_and_ends_the_test():
    record, _ = proven(({"lie": {"kind": "stuck"}},))
    assert list(results_of(record).items()) == [("level", "fail")]
    assert not record["passed"]


def test_a_readback_that_stands_still_fails():
    record, _ = proven(({"lie": {"kind": "readback_stuck"}},))
    assert results_of(record)["level"] == "fail"


@pytest.mark.parametrize("name", STEPS)
def test_ctrl_c_leaves_the_bench_at_rest_and_writes_a_record_that_did_not_pass(name):
    record, _ = proven(interrupted_in=name)
    assert record["steps"][-1]["name"] == name
    assert not record["passed"]
    assert record["left_at_rest"]
    assert record["remark"] == "interrupted"


@pytest.mark.parametrize("event", [("stop",), ("disarm",), ("urge", ("stop",)), ("signal_service", ("SIGTERM", 1))])
@pytest.mark.parametrize("time_s", [2.0, 3.0, 4.0])
def test_another_operator_ends_a_proof_test(event, time_s):
    record, _ = proven(events=(Event(time_s, *event),))
    assert (record["remark"], record["left_at_rest"], record["passed"]) == ("interrupted", True, False)
    assert len(record["steps"]) < len(STEPS)
