"""Rows of the fault list in virtual time: the same injections and expected results, with exact bounds.

`python -m tests.simulation.rows [ID ...]` runs them. A row runs here when each of its steps is one that this module can
do over TCP; the others need a serial port, a system call or a real clock.
"""

import json
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from piezod.control import RingReader, State
from piezod.errors import PiezodError
from piezod.transport import ExchangeResult
from tests.simulation.history import SECOND, History
from tests.simulation.plan import Event, Plan
from tests.simulation.runs import run, warm_up

LIST = Path(__file__).parents[1] / "faults" / "faults.yaml"
FAULT_S = 3.0
ARMED_S = 2.0
WRITES_EVERY_S = 1e-4  # of a second client that writes without a pause
PHASES = 10  # of the reference of 1 Hz, for faults that depend on how the voltage moves
MANY_PHASES = ("P16", "P38", "S11")
SAFE = (State.RAMP_DOWN, State.FAULT)
RULES = ("drop", "delay", "split", "duplicate", "random")
LIES = {
    "heartbeat_reversed": lambda sample, _value, _s, _first: replace(sample, heartbeat=-sample.heartbeat & 0xFFFF),
    "heartbeat_stuck": lambda sample, _value, _s, first: replace(sample, heartbeat=first.heartbeat),
    "readback_stuck": lambda sample, _value, _s, first: replace(sample, voltage_readback_V=first.voltage_readback_V),
    "gain_creep": lambda sample, value, s, _first: replace(sample, force_N=sample.force_N * (1 + value * s)),
    "temperature": lambda sample, value, _s, _first: replace(sample, temperature_C=value),
    "stuck": lambda sample, _value, _s, first: replace(sample, force_N=first.force_N),
    "offset": lambda sample, value, _s, _first: replace(sample, force_N=sample.force_N + value),
    "force": lambda sample, value, _s, _first: replace(sample, force_N=value),
}
STEPS = ("wire", "rules", "refuse", "deaf_to_writes", "second_master", "write_beside", "other_device", "lose_settings",
         "write_register", "lie", "stop_and_go", "edit", "restart", "flap")  # fmt: skip


class RowHistory(History):
    """A history with the steps of a row."""

    def __init__(self, plan, folder, trace=None):
        super().__init__(plan, folder, trace)
        self.observed = {}
        self.fault_ns = 0
        self.commands_before = 0

    def steps(self, text):
        self.fault_ns = self.machine.now_ns
        self.excused.add("row")
        self.commands_before = self.amplifier.device.commands
        for step in json.loads(text):
            ((name, arguments),) = step.items()
            getattr(self, f"do_{name}")(arguments)

    def do_wire(self, what):
        self.network.reset()
        self.network.refuses = self.network.refuses or what == "refuse"

    def do_flap(self, arguments):
        for number in range(arguments["times"]):
            begin_ns = round(number * (arguments["off_s"] + arguments["on_s"]) * SECOND)
            self.machine.after(begin_ns, lambda: self.refuse_connections(arguments["off_s"]))

    def do_rules(self, rules):
        for rule in rules:
            fault = {"random": "garbage"}.get(rule["do"], rule["do"])
            count = rule.get("count", 1) or 1 << 30
            self.wire(fault, rule.get("way", "reply"), count, 1e3 * rule.get("by", 0.0))

    def do_refuse(self, arguments):
        self.amplifier.refusal = (arguments["code"], 1 << 30)
        self.network.unit.only = (arguments.get("function", 0), arguments.get("address", -1))

    def do_deaf_to_writes(self, _):
        self.ignored_writes()

    def do_second_master(self, arguments):
        self.excused.add("foreign")
        for number in range(arguments["times"]):
            delay_ns = round(number * arguments["every_s"] * SECOND)
            self.machine.after(delay_ns, lambda: self.amplifier.device.write_as_other(arguments["above_V"]))

    def do_write_beside(self, arguments):
        times = round(arguments["for_s"] / 0.004)
        self.do_second_master({"above_V": arguments["above_V"], "times": times, "every_s": 0.004})

    def do_other_device(self, arguments):
        for address, word in arguments.get("words", {}).items():
            self.amplifier.device._words[int(address)] = word

    def do_lose_settings(self, _):
        self.network.reset()
        self.amplifier.device.write(110, [0])

    def do_write_register(self, arguments):
        for number in range(round(arguments.get("for_s", 0.0) / WRITES_EVERY_S) + 1):
            self.machine.after(
                round(number * WRITES_EVERY_S * SECOND),
                lambda: self.amplifier.device.write(arguments["address"], [arguments["value"]]),
            )

    def do_lie(self, arguments):
        device, begun_ns, seen = self.amplifier.device, self.machine.now_ns, [0]
        lie, first = LIES[arguments["kind"]], device.sample()

        def fault(sample):
            seen[0] += 1
            if 0 < arguments.get("count", 0) < seen[0]:
                return sample
            elapsed_s = 1e-9 * (self.machine.now_ns - begun_ns)
            return lie(sample, float(arguments.get("value", 0.0)), elapsed_s, first)

        device.reading_fault = fault

    def do_stop_and_go(self, arguments):
        self.pause_control(arguments["for_s"])

    def do_edit(self, arguments):
        text = self.path.read_text(encoding="utf-8")
        assert arguments["old"] in text
        self.path.write_text(text.replace(arguments["old"], arguments["new"]), encoding="utf-8")
        self.service.signal(signal.SIGHUP)

    def do_restart(self, _):
        self.network.reset()
        self.amplifier.device.restart()

    def observe(self):
        """State, times and counts since the fault, from the ring log."""
        try:
            rows = RingReader(self.folder / "ring").read()
        except PiezodError:
            return
        after = rows[rows["time_ns"] >= self.fault_ns]
        safe = np.flatnonzero(np.isin(after["state"], SAFE))
        good = rows[(rows["result"] == ExchangeResult.OK)]
        self.observed = {
            "state": State(int(rows["state"][-1])).name,
            "log": "\n".join(line for process in self.machine.processes for line in process.log),
            "answers": "\n".join(text for _, _, text in self.answers),
            "after_ms": 1e-6 * (int(after["time_ns"][safe[0]]) - self.fault_ns) + 5.0 if safe.size else 0.0,
            "figures": {
                "failed": int((after["result"] != ExchangeResult.OK).sum()),
                "commands_since": self.amplifier.device.commands - self.commands_before,
                "watchdog_ms": self.amplifier.device.watchdog_ms,
            }
            | {result.name.lower(): int((after["result"] == result).sum()) for result in ExchangeResult},
        }
        if safe.size:
            safe_ns = int(after["time_ns"][safe[0]])
            before = good[good["time_ns"] < safe_ns]["time_ns"]
            self.observed["figures"]["silence_ms"] = 1e-6 * (safe_ns - int(before[-1])) if before.size else np.inf

    def finish(self):
        self.observe()
        super().finish()


def rows():
    """The rows that run here, by id."""
    found = {}
    for fault in yaml.safe_load(LIST.read_text(encoding="utf-8"))["faults"]:
        inject = fault["inject"]
        if inject["by"] != "running" or "wire" in inject or inject.get("ends"):
            continue
        if all(_can_do(step) for step in inject["steps"]):
            found[fault["id"]] = fault
    return found


def _can_do(step):
    ((name, arguments),) = step.items()
    if name == "rules":
        return all(rule["do"] in RULES for rule in arguments)
    if name == "other_device":
        return "words" in arguments
    return name in STEPS


def deviations(fault, result):
    """What differs from the expected result of a row; empty when the fault is survived."""
    expect, observed = fault["expect"], result.observed
    if not observed:
        return [f"nothing was observed: {result.violations}"]
    bad = [f"{kind} at {time_s:.3f} s: {text}" for kind, time_s, text in result.violations]
    if observed["state"] != expect["state"]:
        bad.append(f"state {observed['state']}, not {expect['state']}")
    text = observed["log"] + observed["answers"]
    words = [word for word in (fault.get("logged"), *expect.get("says", ())) if word]
    bad += [f"'{word}' is in no line" for word in words if word not in text]
    number, unit = fault["within"].split()
    within_ms = float(number) * {"ms": 1.0, "s": 1e3}[unit]
    if expect["state"] != "RUNNING" and not observed["after_ms"] <= within_ms:
        bad.append(f"after {observed['after_ms']:.1f} ms, must be within {fault['within']}")
    for name, bound in expect.get("figures", {}).items():
        value = observed["figures"].get(name)
        if value is None:
            continue  # a figure of real processes, such as memory
        if value < bound.get("least", value) or value > bound.get("most", value):
            bad.append(f"{name} is {value:g}, must be {bound}")
    return bad


def phases(fault):
    """Times at which the fault of a row is injected [s]."""
    return [FAULT_S + n / PHASES for n in range(PHASES if fault["id"] in MANY_PHASES else 1)]


def run_row(fault, fault_s=FAULT_S, seed=1, **settings):
    """Run a row; the deviations and what was observed."""
    steps = json.dumps(fault["inject"]["steps"])
    plan = Plan(seed, fault_s + 6.0, events=(Event(ARMED_S, "arm"), Event(fault_s, "steps", (steps,))), **settings)
    result = run(plan, make=RowHistory)
    return deviations(fault, result), result


def main(names):
    warm_up()
    failed = 0
    for name, fault in rows().items():
        if names and name not in names:
            continue
        for fault_s in phases(fault):
            bad, result = run_row(fault, fault_s)
            failed += bool(bad)
            after = result.observed.get("after_ms", 0.0)
            print(f"{name:5} {fault['fault'][:60]:60} {after:8.1f} ms  {'; '.join(bad) or 'survived'}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
