"""Rows of the fault list in virtual time: the same injections and expected results, with exact bounds.

`python -m tests.simulation.rows [ID ...]` runs them. A row runs here when each of its steps is one that this module can
do over TCP; the others need a serial port, a system call or a real clock.
"""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from tests.simulation.plan import Event, Plan
from tests.simulation.row_history import LIES, STREAMED_N, RowHistory
from tests.simulation.runs import run, warm_up

LIST = Path(__file__).parents[1] / "faults" / "faults.yaml"
FAULT_S = 3.0
ARMED_S = 2.0
OF_PROCESSES = (
    "cpu_percent",
    "deeds",
    "descriptors_grown",
    "ready_ms",
    "resident_grown_kib",
)  # only a real one has them
PHASES = 10  # of the reference of 1 Hz, for faults that depend on how the voltage moves
MANY_PHASES = ("P16", "P38", "S11")
RULES = ("drop", "delay", "split", "duplicate", "random", "throttle", "forge")
STEPS = (
    "clients", "deaf_to_writes", "edit", "fault_bits", "flap", "idle", "lie", "lose_settings", "other_device", "refuse",
    "restart", "rules", "second_master", "stop_and_go", "wire", "write_beside", "write_register",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One history of a row: its events, and what differs from the usual bench."""

    events: tuple
    fault_s: float = FAULT_S
    after_s: float = 6.0
    settings: dict = field(default_factory=dict)


def _steps(time_s, steps):
    return Event(time_s, "steps", (json.dumps(steps),))


def _running(inject, fault_s):
    before = (_steps(fault_s - 0.2, inject["before"]),) if "before" in inject else ()
    return [Case((Event(ARMED_S, "arm"), *before, _steps(fault_s, inject["steps"])), fault_s)]


def _variants(inject, fault_s):
    return [case for steps in inject["each"] for case in _running({"steps": steps}, fault_s)]


def _arming(inject, _):
    return [Case((_steps(ARMED_S, inject["steps"]), Event(ARMED_S, "arm")), ARMED_S)]


def _disarmed(inject, _):
    return [Case((_steps(ARMED_S, inject["steps"]),), ARMED_S, 2.0)]


def _signalled(inject, fault_s):
    pause_s = inject.get("pause_s", 0.05)
    signals = [Event(fault_s + n * pause_s, "signal_service", (name, 1)) for n, name in enumerate(inject["signals"])]
    before = (_steps(fault_s - 0.2, inject["before"]),) if "before" in inject else ()
    return [Case((Event(ARMED_S, "arm"), *before, _steps(fault_s, [{"mark": True}]), *signals), fault_s)]


def _killed(inject, fault_s):
    """Both processes end; the watchdog of the device acts; the service starts again."""
    events = []
    for n in range(inject["times"]):
        at_s = fault_s + 5.0 * n
        events += [Event(at_s - 1.0, "arm"), _steps(at_s, [{"mark": True}, {"kill": True}]), Event(at_s + 2.0, "start")]
    return [Case(tuple(events), fault_s, 5.0 * inject["times"])]


def _parent_killed(inject, fault_s):
    limits = WITHOUT_WATCHDOG | inject.get("changes", {}).get("limits", {})
    changes = (*(("limits", name, value) for name, value in limits.items()), ARM_WITHOUT_WATCHDOG)
    steps = [{"mark": True}, {"kill_parent": inject}]
    return [Case((Event(ARMED_S, "arm"), _steps(fault_s, steps)), fault_s, 3.0, {"changes": changes})]


def _reset_off_rest(_inject, fault_s):
    changes = (("limits", "device_watchdog_ms", 0), ("limits", "comm_loss_action", "hold"), ARM_WITHOUT_WATCHDOG)
    steps = [{"hold_output": True}, {"wire": "refuse"}]
    events = (
        Event(ARMED_S, "arm"),
        _steps(fault_s, steps),
        Event(fault_s + 1.0, "heal"),
        Event(fault_s + 2.0, "reset"),
    )
    return [Case(events, fault_s, 4.0, {"changes": changes})]


def _refused_at_start(inject, _):
    changes = {"edit": (inject.get("old"), inject.get("new")), "steps": json.dumps(inject.get("steps", ()))}
    return [Case((), 0.0, 6.0, {"at_start": changes})]


def _stale_stream(inject, _):
    sent = [Event(1.0 + 0.001 * n, "datagram", (250.0, -1)) for n in range(inject["count"])]
    armed_s = 1.2 + inject["rest_s"]
    events = (*sent, _steps(armed_s, [{"mark": True}]), Event(armed_s, "arm"))
    return [Case(events, armed_s, inject["arm_s"], STREAMED)]


def _restarted_sender(inject, fault_s):
    begin = Event(1.0, "begin_stream", (STREAMED_N, inject["first"]))
    again = (Event(fault_s + 1.0, "begin_stream", (STREAMED_N, 0)), Event(fault_s + 1.0, "arm"))
    stops = (Event(fault_s, "stream_ends"), Event(fault_s, "disarm"))
    marks = _steps(fault_s + 1.0, [{"mark": True}])
    return [Case((begin, Event(ARMED_S, "arm"), *stops, marks, *again), fault_s, 4.0, STREAMED)]


def _wild_datagrams(inject, fault_s):
    begin = (Event(1.0, "begin_stream", (STREAMED_N, 0)), Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}]))
    wild = [Event(fault_s + 0.01, "datagram", (STREAMED_N, number)) for number in inject.get("numbers", ())]
    absurd = [Event(fault_s + 0.03 * n, "beside", (value,)) for n, value in enumerate(inject.get("values", ()))]
    junk = [Event(fault_s + 0.2 + 0.005 * n, "junk", (24, 1)) for n in range(inject.get("junk", 0))]
    asks = Event(fault_s + 2.0, "ask_values")
    return [Case((*begin, *wild, *absurd, *junk, asks), fault_s, 3.0, STREAMED)]


def _wall_clock(_inject, fault_s):
    jumps = [Event(fault_s + 0.25 * n, "wall_clock", (-7200.0 if n % 2 else 7200.0,)) for n in range(8)]
    events = (Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}]), *jumps)
    return [Case(events, fault_s, 2.0)]


WITHOUT_WATCHDOG = {"device_watchdog_ms": 0}
ARM_WITHOUT_WATCHDOG = ("arming", "without", ["device_watchdog"])
STREAMED = {"reference": "stream", "changes": (("reference", "when_stale", "hold"),)}
INJECTORS = {
    "running": _running, "variants": _variants, "arming": _arming, "disarmed": _disarmed, "signalled": _signalled,
    "killed": _killed, "parent_killed": _parent_killed, "reset_off_rest": _reset_off_rest,
    "refused_at_start": _refused_at_start, "stale_stream": _stale_stream, "restarted_sender": _restarted_sender,
    "wild_datagrams": _wild_datagrams, "wall_clock": _wall_clock,
}  # fmt: skip


def rows():
    """The rows that run here, by id."""
    found = {}
    for fault in yaml.safe_load(LIST.read_text(encoding="utf-8"))["faults"]:
        inject = fault["inject"]
        if inject["by"] in INJECTORS and "wire" not in inject and all(map(_can_do, _steps_of(inject))):
            found[fault["id"]] = fault
    return found


def _steps_of(inject):
    return [
        *inject.get("before", ()),
        *inject.get("steps", ()),
        *(one for steps in inject.get("each", ()) for one in steps),
    ]


def _can_do(step):
    ((name, arguments),) = step.items()
    if name == "rules":
        return all(rule["do"] in RULES for rule in arguments)
    if name == "other_device":
        return "shift" not in arguments
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
    if wanted not in ([""], ["none"]) and observed["state"] not in wanted:
        bad.append(f"state {observed['state']}, not {expect['state']}")
    if expect.get("exit_code", observed["exit_code"]) != observed["exit_code"] and "reset" not in fault["fault"]:
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
    bad, result = [], None
    for case in INJECTORS[fault["inject"]["by"]](fault["inject"], fault_s):
        plan = Plan(seed, case.fault_s + case.after_s, events=case.events, **case.settings | settings)
        result = run(plan, make=RowHistory)
        bad += deviations(fault, result)
    return bad, result


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
