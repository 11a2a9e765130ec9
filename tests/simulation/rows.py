"""Rows of the fault list in virtual time: the same injections and expected results, with exact bounds.

`python -m tests.simulation.rows [ID ...]` runs them. A row runs here when each of its steps is one that this module can
do; the others need a system call, a file system, a right or a real clock.
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import yaml

from tests.simulation.plan import Plan
from tests.simulation.row_cases import DISK_FAULTS, FAULT_S, INJECTORS
from tests.simulation.row_history import LIES, RowHistory
from tests.simulation.runs import run, warm_up

LIST = Path(__file__).parents[1] / "faults" / "faults.yaml"
OF_PROCESSES = (
    "cpu_percent",
    "deeds",
    "descriptors_grown",
    "ready_ms",
    "resident_grown_kib",
)  # only a real one has them
PHASES = 10  # of the reference of 1 Hz, for faults that depend on how the voltage moves
MANY_PHASES = ("P16", "P38", "S11")
RULES = ("corrupt", "delay", "drop", "duplicate", "echo", "forge", "lag", "noise", "random", "split", "throttle")
STEPS = (
    "clients", "deaf_to_writes", "edit", "fault_bits", "flap", "idle", "lie", "lose_settings", "measure_cpu",
    "other_device", "refuse", "replug", "restart", "rules", "second_master", "stop_and_go", "wire", "write_beside",
    "write_register",
)  # fmt: skip


@cache
def rows():
    """The rows that run here, by id."""
    found = {}
    for fault in yaml.safe_load(LIST.read_text(encoding="utf-8"))["faults"]:
        inject = fault["inject"]
        if inject["by"] in INJECTORS and all(map(_can_do, _steps_of(inject))):
            found[fault["id"]] = fault
    return found


def _steps_of(inject):
    return [
        *inject.get("before", ()),
        *inject.get("steps", ()),
        *(one for steps in inject.get("each", ()) for one in steps),
        *({"part": part} for part in [inject.get("part")] if part),
    ]


def _can_do(step):
    ((name, arguments),) = step.items()
    if name == "rules":
        return all(rule["do"] in RULES for rule in arguments)
    if name == "part":
        return arguments in DISK_FAULTS
    if name == "lie":
        return arguments["kind"] in LIES
    return name in STEPS


def deviations(fault, result):
    """What differs from the expected result of a row; empty when the fault is survived."""
    expect, observed = fault["expect"], result.observed
    if not observed:
        return [f"nothing was observed: {result.violations}"]
    bad = [f"{kind} at {time_s:.3f} s: {text}" for kind, time_s, text in result.violations]
    wanted = expect.get("state", "").split(" or ")
    if wanted == ["DISARMED"] and observed["exit_code"]:
        wanted = ["DISARMED", "none"]  # a service that has ended drives nothing
    if wanted not in ([""], ["none"]) and observed["state"] not in wanted:
        bad.append(f"state {observed['state']}, not {expect['state']}")
    if expect.get("exit_code", observed["exit_code"]) != observed["exit_code"]:
        bad.append(f"exit code {observed['exit_code']}, not {expect['exit_code']}")
    text = (observed["log"] + observed["answers"]).lower()
    words = [word for word in (fault.get("logged"), *expect.get("says", ())) if word]
    bad += [f"'{word}' is in no line" for word in words if word.lower() not in text]
    number, unit = fault["within"].split()
    within_ms = float(number) * {"ms": 1.0, "s": 1e3}[unit]
    if expect.get("state", "RUNNING") not in ("RUNNING", "none") and not observed["after_ms"] <= within_ms:
        bad.append(f"after {observed['after_ms']:.1f} ms, must be within {fault['within']}")
    for name, bound in expect.get("figures", {}).items():
        value = observed["figures"].get(name)
        if value is None:
            bad += [] if name in OF_PROCESSES else [f"{name} is unknown"]
            continue
        if value < bound.get("least", value) or value > bound.get("most", value):
            bad.append(f"{name} is {value:g}, must be {bound}")
    return bad


def phases(fault):
    """Times at which the fault of a row is injected [s]."""
    return [FAULT_S + n / PHASES for n in range(PHASES if fault["id"] in MANY_PHASES else 1)]


def run_row(fault, fault_s=FAULT_S, seed=1, **settings):
    """Run a row, each of its variants in a history of its own; the deviations and the result of the last."""
    bad, result, merged = [], None, []
    wire = {"wire": fault["inject"].get("wire", "tcp")}
    if fault["inject"]["by"] == "port_taken":
        wire = {"wire": "rtu"}
    for case in INJECTORS[fault["inject"]["by"]](fault["inject"], fault_s):
        plan = Plan(seed, case.fault_s + case.after_s, events=case.events, **wire | case.settings | settings)
        result = run(plan, make=RowHistory)
        if case.merged:
            merged.append(result)
        else:
            bad += deviations(fault, result)
    if merged:
        result = together(merged)
        bad += deviations(fault, result)
    return bad, result


def together(results):
    """One result of several histories: texts joined, counts added, the last exit code, the longest time."""
    if bad := [one for one in results if not one.observed or "figures" not in one.observed]:
        return bad[0]
    figures = {}
    for result in results:
        for name, value in result.observed["figures"].items():
            figures[name] = figures.get(name, 0.0) + value
    last = results[-1]
    observed = last.observed | {
        "state": results[0].observed["state"], "figures": figures,
        "log": "\n".join(one.observed["log"] for one in results),
        "answers": "\n".join(one.observed["answers"] for one in results),
        "after_ms": max(one.observed["after_ms"] for one in results),
    }  # fmt: skip
    return replace(last, observed=observed, violations=[found for one in results for found in one.violations])


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
