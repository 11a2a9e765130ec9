"""The histories of the rows of the fault list: for each injector, its events and what differs from the usual bench."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.blocked_stops import WAYS
from tests.simulation.plan import Event
from tests.simulation.row_scripts import KEY, STREAMED_N

ROOT = Path(__file__).parents[2]
FAULT_S = 3.0
ARMED_S = 2.0


@dataclass(frozen=True)
class Case:
    """One history of a row: its events, and what differs from the usual bench."""

    events: tuple
    fault_s: float = FAULT_S
    after_s: float = 6.0
    settings: dict = field(default_factory=dict)
    merged: bool = False  # judged together with the other histories of the row


def _steps(time_s, steps):
    return Event(time_s, "steps", (json.dumps(steps),))


def _running(inject, fault_s):
    before = (_steps(fault_s - 0.2, inject["before"]),) if "before" in inject else ()
    changes = [(section, *one) for section, new in inject.get("changes", {}).items() for one in new.items()]
    events = (Event(ARMED_S, "arm"), *before, _steps(fault_s, inject["steps"]))
    return [Case(events, fault_s, settings={"changes": tuple(changes)} if changes else {})]


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
        Event(fault_s + 2.0, "script", ("reset", "{}")),
    )
    return [Case(events, fault_s, 4.0, {"changes": changes})]


def _refused_at_start(inject, _):
    edit = {"edit": (inject.get("old"), inject.get("new")), "steps": json.dumps(inject.get("steps", ()))}
    return [Case((), 0.0, 6.0, {"at_start": START | edit})]


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


def _scripted(name, at_s=ARMED_S, after_s=6.0, **more):
    """An injector whose parameters are those of a function of `row_scripts.py`."""

    def cases(inject, _):
        arguments = {key: value for key, value in inject.items() if key not in ("by", "changes")}
        script = Event(at_s, "script", (name, json.dumps(arguments)))
        return [Case((script,), at_s, after_s, {"sections": LONG_LOG | inject.get("changes", {})} | more)]

    return cases


def _driven(name):
    """As `_scripted`, while the bench is driven."""

    def cases(inject, fault_s):
        arguments = json.dumps({key: value for key, value in inject.items() if key != "by"})
        events = (Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}]), Event(fault_s, "script", (name, arguments)))
        return [Case(events, fault_s, 6.0)]

    return cases


def _arming_timeout(inject, _):
    sections = {"reference": {"kind": "stream", "listen": "FOLDER/stream", "when_stale": "ramp_down"},
                "limits": {"arming_timeout_s": 10.0}} | LONG_LOG  # fmt: skip
    events = (_steps(ARMED_S, [{"mark": True}]), Event(ARMED_S, "script", ("arm", "{}")))
    return [Case(events, ARMED_S, inject["wait_s"], {"sections": sections})]


def _out_of_reach(inject, _):
    ask = Event(ARMED_S + 1.0 + inject["wait_s"], "script", ("ask_for_rail", "{}"))
    events = (_steps(ARMED_S, [{"mark": True}]), Event(ARMED_S, "arm"), ask)
    return [Case(events, ARMED_S, inject["wait_s"] + 1.5, {"sections": {"reference": inject["reference"]}})]


def _absurd_file(inject, _):
    value, gap_s, cut = inject.get("value", 100.0), inject.get("gap_s", 0.0), inject.get("cut", 0)
    lines = [f"{k / 100 + gap_s * (k == 99)},{value if k == 50 else 100.0}" for k in range(100)]
    text = "time_s,reference_N\n" + "\n".join(lines) + "\n"
    sections = {"reference": {"kind": "file", "path": "FOLDER/reference.csv"}}
    settings = {"sections": sections, "files": {"reference.csv": text[: len(text) - cut]}, "at_start": START}
    return [Case((), 0.0, 6.0, settings)]


def _another_model(inject, _):
    model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    assert inject["old"] in model
    files = {"model.yaml": model.replace(inject["old"], inject["new"], 1)}
    return [Case((), 0.0, 6.0, {"sections": OWN_MODEL, "files": files, "at_start": START})]


def _forged_stream(_inject, _):
    reference = {"kind": "stream", "listen": "FOLDER/stream", "stale_after_s": 0.2, "when_stale": "hold",
                 "key_file": "FOLDER/key"}  # fmt: skip
    settings = {"sections": {"reference": reference}, "files": {"key": KEY.hex()}}
    return [Case((Event(ARMED_S, "script", ("forge_stream", "{}")),), ARMED_S, 6.0, settings)]


def _blocked(inject, _):
    """A stop in each way; the figures of all are added."""
    model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    reference = {"kind": "triangle", "amplitude_N": 1.0, "offset_N": 120.0, "frequency_Hz": 0.5}
    settings = {"sections": OWN_MODEL | {"reference": reference}, "files": {"model.yaml": model}}
    return [
        Case((Event(ARMED_S, "script", ("stop_while_blocked", json.dumps({"blockade": blockade, "way": way}))),),
             ARMED_S, 9.0, settings, merged=True)
        for blockade in inject["blockades"] for way in WAYS
    ]  # fmt: skip


def _second_instance(_inject, _):
    events = (_steps(ARMED_S, [{"mark": True}]), Event(ARMED_S, "script", ("start_beside", "{}")))
    return [Case(events, ARMED_S, 4.0)]


def _shared_device(inject, fault_s):
    second = {"name": "another", "daemon": {"ring_log": "FOLDER/second"}, "link": {"host": inject["host"]}}
    events = (Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}]),
              Event(fault_s, "script", ("start_beside", json.dumps(second))))  # fmt: skip
    return [Case(events, fault_s, 4.0)]


def _left_behind(_inject, _):
    return [Case((), 0.0, 3.0, {"at_start": START | {"arms": False, "steps": json.dumps([{"left_behind": True}])}})]


def _unreachable(inject, _):
    """The service stays active; with `--arm` it ends."""
    shut = json.dumps([{"shut": inject["door"]}])
    attempt = Event(4.0, "script", ("try_to_connect", "{}"))
    return [
        Case((attempt,), 0.0, 8.0, {"at_start": START | {"arms": False, "steps": shut}}, merged=True),
        Case((), 0.0, 8.0, {"at_start": START | {"steps": shut}}, merged=True),
    ]


def _failed_start(inject, _):
    shut = json.dumps([{"shut": "closed"}])
    clients = Event(0.0, "script", ("connect_all_the_time", "{}"))
    return [Case((clients,), 0.0, 6.0, {"at_start": START | {"steps": shut}}, merged=True)] * inject["times"]


def _at_start(step):
    return lambda _inject, _: [Case((), 0.0, 6.0, {"at_start": START | {"steps": json.dumps([{step: True}])}})]


def _skewed(_inject, fault_s):
    return [
        Case((Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}])), fault_s, 2.0, {"effects": ("clock_skew",)})
    ]


def _hung(_inject, fault_s):
    events = (Event(ARMED_S, "arm"), Event(fault_s, "script", ("hang", "{}")))
    return [Case(events, fault_s, 3.0)]


def _recorded(inject, fault_s):
    """Faults of the disk, or kills, while the bench is driven and recorded."""
    faults = DISK_FAULTS[inject["part"]] or [DISK_FAULTS_BY_NAME[name] for name in inject["only"]]
    cases = []
    for fault, every, for_s in faults:
        if fault == "kill":
            kills = [Event(fault_s + 0.3 + 1.3 * n, "kill_recorder") for n in range(inject["amount"])]
        else:
            kills = [Event(fault_s + 0.3, "disk_fault", (fault, every, for_s))]
        events = (Event(ARMED_S, "arm"), _steps(fault_s, [{"mark": True}]), *kills)
        cases.append(Case(events, fault_s, for_s + 6.0, {"recorder": True}, merged=True))
    return cases


DISK_FAULTS = {
    "full": [("full", 1, 1.0), ("full", 1, 3.0), ("full", 2, 5.0)],
    "kills": [("kill", 1, 4.0)],
    "faults": [],
}
DISK_FAULTS_BY_NAME = {
    "EIO at every 20th sync": ("io_error", 20, 30.0),
    "EIO at every 400th write": ("io_error", 8, 30.0),  # a sync has some fifty writes
    "every 20th sync takes 5 s": ("slow", 20, 40.0),
}
START = {"edit": (None, None), "steps": "[]", "arms": True}
LONG_LOG = {"daemon": {"ring_seconds": 60}}
OWN_MODEL = {"model": "FOLDER/model.yaml"}
WITHOUT_WATCHDOG = {"device_watchdog_ms": 0}
ARM_WITHOUT_WATCHDOG = ("arming", "without", ["device_watchdog"])
STREAMED = {"reference": "stream", "changes": (("reference", "when_stale", "hold"),)}
INJECTORS = {
    "running": _running, "variants": _variants, "arming": _arming, "disarmed": _disarmed, "signalled": _signalled,
    "killed": _killed, "parent_killed": _parent_killed, "reset_off_rest": _reset_off_rest,
    "refused_at_start": _refused_at_start, "stale_stream": _stale_stream, "restarted_sender": _restarted_sender,
    "wild_datagrams": _wild_datagrams, "wall_clock": _wall_clock, "armed_without_reference": _arming_timeout,
    "reference_out_of_reach": _out_of_reach, "absurd_file": _absurd_file, "another_model": _another_model,
    "reloaded_while_starting": _scripted("reload_while_starting"),
    "reloaded_while_driving": _scripted("tighten_while_driving", after_s=15.0),
    "reloaded_between_two_drives": _scripted("reload_between_two_drives", after_s=16.0),
    "armed_with_late_replies": _scripted(
        "arm_with_late_replies",
        after_s=16.0,
        changes=(("link", "timeout_s", 3.0), ("link", "heartbeat_within_s", 10.0)),
    ),
    "hostile_clients": _driven("send_hostile_lines"), "crowded": _driven("crowd"), "forged_stream": _forged_stream,
    "blocked": _blocked, "second_instance": _second_instance, "shared_device": _shared_device,
    "left_behind": _left_behind, "unreachable": _unreachable, "failed_start_with_clients": _failed_start,
    "one_client_only": _at_start("other_client"), "port_taken": _at_start("hold_port"), "skewed_device": _skewed,
    "unfed_watchdog": _hung, "recorded": _recorded,
}  # fmt: skip
