"""What happens in a history: settings and events, drawn from its seed.

A swarm: each seed draws which kinds of events are possible at all, and how often they come, so that rare combinations
meet. The list is complete before the history begins. A failing history can therefore be repeated with fewer events.
"""

import random
from dataclasses import dataclass, field, replace

COMMANDS = ("arm", "disarm", "stop", "reset", "status")
SETTLED_S = 2.0  # at the end of a history nothing new happens


@dataclass(frozen=True)
class Event:
    """Something that happens at a time [s]."""

    time_s: float
    name: str
    arguments: tuple = ()

    def __str__(self):
        return f"{self.time_s:9.4f} s  {self.name} {' '.join(map(str, self.arguments))}".rstrip()


@dataclass(frozen=True)
class Plan:
    """Settings of the bench and the machine, and the events in their order."""

    seed: int
    seconds: float
    rate_Hz: int = 200
    reference: str = "sine"
    wire: str = "tcp"
    recorder: bool = False
    metrics: bool = False
    drift: bool = False
    frequency_Hz: float = 1.0
    latency_ns: tuple = (20_000, 30_000)
    events: tuple = field(default=())
    changes: tuple = field(default=())  # of the bench file, each (section, key, value)
    sections: dict = field(default_factory=dict)  # of the bench file; "FOLDER" in a value is the folder of the history
    files: dict = field(default_factory=dict)  # further files of the folder, with their texts
    effects: tuple = ()  # of the emulated bench
    at_start: dict = field(
        default_factory=dict
    )  # an edit of the bench file, steps before the start, with `--arm` or not

    def without(self, numbers):
        """The same without the events of some numbers."""
        return replace(self, events=tuple(event for n, event in enumerate(self.events) if n not in numbers))


def _pick(choices):
    return lambda rng: (rng.choice(choices),)


# the weight of an event, and the function that draws its arguments
KINDS = {
    "disarm": (2, lambda rng: ()),
    "stop": (2, lambda rng: ()),
    "urge": (3, _pick(("stop", "disarm"))),
    "reset": (2, lambda rng: ()),
    "status": (1, lambda rng: ()),
    "scrape": (1, lambda rng: (rng.choice((1, 1, 40)), rng.randrange(4))),
    "reload": (2, lambda rng: (rng.choice((50.0, 100.0, 150.0, 250.0, 360.0, 500.0)), rng.random() < 0.3)),
    "reload_broken": (1, lambda rng: (rng.choice(("", "rate_Hz: [", "limits: 3\n")), rng.random() < 0.5)),
    "strangers": (1, lambda rng: (rng.choice((1, 12, 70)), rng.randrange(4))),
    "signal_service": (1, lambda rng: (rng.choice(("SIGTERM", "SIGINT")), rng.choice((1, 1, 3)))),
    "kill_service": (1, lambda rng: ()),
    "kill_control": (1, lambda rng: ()),
    "kill_all": (1, lambda rng: ()),
    "pause_control": (1, lambda rng: (rng.choice((0.02, 0.1, 0.35, 1.5)),)),
    "pause_service": (1, lambda rng: (rng.choice((0.1, 0.5, 2.0)),)),
    "stall": (2, lambda rng: (rng.choice((0.004, 0.008, 0.02, 0.1, 0.6)),)),
    "wall_clock": (1, lambda rng: (rng.choice((-3600.0, -0.5, 0.5, 3600.0)),)),
    "false_reading": (3, lambda rng: (
        rng.choice(("force", "offset", "reversed", "gain", "stuck", "frozen", "heartbeat_stuck", "readback", "nan")),
        rng.choice((0.0, 1.0, 30.0, 500.0)), rng.choice((1, 3, 0)))),
    "refusal": (2, lambda rng: (rng.choice((1, 2, 4, 6)), rng.choice((1, 5, 400)))),
    "ignored_writes": (1, lambda rng: ()),
    "restart_device": (1, lambda rng: ()),
    "watchdog": (1, lambda rng: (rng.choice((0, 5000)),)),
    "other_master": (1, lambda rng: (rng.choice((0.5, 2.0, 4.5)), rng.choice((1, 20, 100)))),
    "lost_reply": (2, lambda rng: ()),
    "exchange_device": (1, lambda rng: ()),
    "trip_amplifier": (1, lambda rng: ()),
    "wire": (4, lambda rng: (
        rng.choice(("delay", "drop", "split", "corrupt", "reset", "noise", "duplicate")),
        rng.choice(("request", "reply")), rng.choice((1, 1, 10)), rng.choice((0.5, 2.0, 20.0)))),
    "cut": (1, lambda rng: (rng.choice((0.02, 0.2, 1.0)),)),
    "refuse_connections": (1, lambda rng: (rng.choice((0.2, 1.0, 5.0)),)),
    "stream": (3, lambda rng: (rng.choice((60.0, 120.0, 200.0, 340.0)),)),
    "stream_ends": (1, lambda rng: ()),
    "datagram": (1, lambda rng: (rng.choice((0.0, -50.0, 1e300, float("nan"), 250.0)),
                                 rng.choice((-1, 0, 1, 2**64 - 1)))),
    "junk": (1, lambda rng: (rng.choice((0, 1, 24, 40, 5000)), rng.choice((1, 50)))),
    "disk_fault": (1, lambda rng: (rng.choice(("full", "io_error", "slow", "read_only")), rng.choice((1, 1, 7)),
                                   rng.choice((0.3, 2.0, 6.0)))),
    "kill_recorder": (1, lambda rng: ()),
    "remove_files": (1, lambda rng: (rng.choice(("ring", "ring.sock", "ring.sock.stop", "ring.lock", "locks")),)),
    "second_service": (1, lambda rng: ()),
}  # fmt: skip


STARTED_S = 1.7  # from the begin of a start, or of a reload, until a control process is connected
MEETING = ("arm", "stop", "disarm", "urge", "urge", "reset", "reload", "reload", "signal_service", "remove_files",
           "remove_files", "kill_control", "kill_service", "pause_control", "second_service", "strangers",
           "refuse_connections")  # fmt: skip
ORDERLY = ("disarm", "stop", "urge", "reload", "signal_service", "kill_service", "stream", "stream_ends")


def _nothing(_rng, time_s, _events):
    return time_s


def _trip(rng, time_s, events):
    """A limit below the force that is driven."""
    time_s += rng.uniform(0.7, 1.5)
    events.append(Event(time_s, "reload", (100.0, False)))
    return time_s + 2.0


def _replies(rng, time_s, events):
    """Single replies are lost."""
    for _ in range(4):
        time_s = max(time_s, 2.5) + rng.uniform(1.05, 1.3)
        events.append(Event(time_s, "lost_reply"))
    return time_s


def _stopped(rng, time_s, events):
    """A stop that overtakes the arm, or a signal that meets it."""
    if rng.random() < 0.3:
        events.append(Event(time_s + rng.uniform(0.0, 0.04), "signal_service", ("SIGTERM", 1)))
        events.append(Event(time_s + 2.0, "start"))
        return time_s + 4.0
    events += [Event(time_s + rng.uniform(0.0, 0.004), "urge", ("stop",)), Event(time_s + 2.5, "arm")]
    return time_s + 2.6


def _starting(rng, time_s, events):
    """Something arrives while a control process starts: with the service, after a reload, or without a device."""
    begin = rng.choice(("first", "reload", "reload", "again", "armed", "unreachable"))
    if begin == "first":
        events += _meeting(rng, 0.0)
        return time_s + 1.5
    if begin == "reload":  # read and taken before anything is driven
        events[:] = [event for event in events if event.name != "arm"]
        begun_s = time_s - 0.1
        events.append(Event(begun_s, "reload", (rng.choice((250.0, 350.0)), rng.random() < 0.3)))
    else:
        killed_s, begun_s = time_s + rng.uniform(0.7, 1.5), time_s + 2.5
        events += [Event(killed_s, "kill_all"), Event(begun_s, "start", (begin == "armed",))]
    if begin == "unreachable":
        events.append(Event(begun_s - 0.1, "refuse_connections", (rng.choice((1.0, 6.0)),)))
        events.append(Event(begun_s + 7.5, "heal"))
        time_s += 6.0
    events += _meeting(rng, begun_s, 5.0 if begin == "unreachable" else STARTED_S)
    if begin != "armed" or rng.random() < 0.5:
        events.append(Event(time_s + 5.0, "arm"))
    return time_s + 7.0


def _meeting(rng, begun_s, within_s=STARTED_S):
    """What meets a control process that starts at a time."""
    events = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        name = rng.choice(MEETING)
        arguments = (rng.choice((50.0, 100.0)), rng.random() < 0.3) if name == "reload" else _arguments(name, rng)
        events.append(Event(begun_s + rng.uniform(0.02, within_s), name, arguments))
    return events


def _arguments(name, rng):
    return KINDS[name][1](rng) if name in KINDS else ()


def _removed(rng, time_s, events):
    """A file of the service is removed; then somebody may start it once more."""
    time_s += rng.uniform(0.7, 1.5)
    name = rng.choice(("ring.sock.stop", "ring.sock", "ring.lock", "locks"))
    if rng.random() < 0.3:  # no device answers
        events += [Event(time_s, "kill_all"), Event(time_s + 0.1, "refuse_connections", (9.0,)),
                   Event(time_s + 0.2, "start"), Event(time_s + 2.5, "remove_files", (name,)),
                   Event(time_s + 6.0, "heal")]  # fmt: skip
        return time_s + 7.0
    events.append(Event(time_s, "remove_files", (name,)))
    if rng.random() < 0.5:
        events.append(Event(time_s + rng.uniform(0.0, 2.5), "second_service"))
    return time_s + 3.5


def _watchdog(rng, time_s, events):
    """Another client changes the watchdog of the device."""
    events.append(Event(time_s + rng.uniform(0.7, 1.5), "watchdog", (rng.choice((0, 5000)),)))
    return time_s + 4.0


def _late(rng, time_s, events):
    """A command waits in the pipe of a control process that stands."""
    for_s = rng.choice((0.5, 3.0, 6.0, 10.5, 12.0))
    if rng.random() < 0.5:
        events += [Event(time_s + 1.0, "trip_amplifier"), Event(time_s + 3.0, "heal")]
        time_s += 4.5
        events.append(Event(time_s, "reset"))
    asked_s = time_s + rng.uniform(0.0, for_s)
    asks = rng.choice((Event(asked_s, "status"), Event(asked_s, "scrape", (1, 0))))
    events += [Event(time_s - 0.05, "pause_control", (for_s,)), asks, Event(time_s + for_s + 1.5, "status")]
    return time_s + for_s + 2.0


def _alone(rng, time_s, events):
    """One fault of the device."""
    name = rng.choice(("restart_device", "exchange_device", "trip_amplifier", "other_master", "ignored_writes"))
    events.append(Event(time_s + rng.uniform(0.7, 2.5), name, KINDS[name][1](rng)))
    return time_s + 4.0


def _unsent(rng, time_s, events):
    """The sender of a stream ends before or after the arm, and nothing else happens."""
    events.append(Event(time_s + rng.uniform(-0.3, 1.5), "stream_ends"))
    return time_s + 5.5


def _silent(rng, time_s, events):
    """The device is silent while nothing is driven, and clients ask for its values."""
    events[:] = [event for event in events if event.name != "arm"]
    events.append(Event(time_s, *rng.choice((("cut", (4.0,)), ("refuse_connections", (4.0,))))))
    for _ in range(3):
        asked = rng.choice((("status", ()), ("scrape", (1, 0))))
        events.append(Event(time_s + rng.uniform(0.5, 3.9), *asked))
    return time_s + 5.0


PROLOGUES = (_nothing, _nothing, _trip, _replies, _replies, _stopped, _starting, _starting, _removed, _watchdog, _late,
             _alone, _unsent, _silent)  # fmt: skip
"""Begins of a history in which one thing only goes wrong."""


COMMANDED = (*["arm"] * 4, "stop", "disarm", "urge", "reset", "status")  # by each of two clients
STRUCK = ("reload", "false_reading", "refusal", "restart_device", "trip_amplifier", "other_master", "wire", "cut",
          "pause_control", "stall", "kill_control", "kill_service", "signal_service", "ignored_writes")  # fmt: skip


def draw_contest(seed, seconds):
    """Two clients, two verbs and faults: the clients know nothing of each other, and everything meets."""
    rng = random.Random(f"contest {seed}")
    is_drive = rng.random() < 0.4  # a command that drives, while nobody serves the bench
    events = [Event(0.3, "signal_service", ("SIGTERM", 1)), Event(1.2, "drive_once")] if is_drive else []
    for _ in range(2):
        time_s = rng.uniform(1.8, 2.4)
        while time_s < seconds - 1.0:
            name = rng.choice(COMMANDED)
            events.append(Event(time_s, name, _arguments(name, rng)))
            time_s += rng.choice((0.001, 0.05, 1.0, 2.0)) * rng.uniform(0.2, 2.0)
    for _ in range(rng.choice((0, 1, 2, 3))):
        name = rng.choice(STRUCK)
        events.append(Event(rng.uniform(2.0, seconds - 1.5), name, _arguments(name, rng)))
    if rng.random() < 0.4:  # a limit below the force that is driven
        events.append(Event(rng.uniform(3.0, 4.5), "reload", (50.0, False)))
    verbs = rng.sample(("drive_once", "second_service", "start"), rng.choice((0, 1, 2)))
    events += [Event(rng.uniform(1.0, seconds - 1.0), name) for name in verbs]
    events.sort(key=lambda event: event.time_s)
    return Plan(seed, seconds, rate_Hz=rng.choice((100, 200)), wire=rng.choice(("tcp", "rtu")), events=tuple(events))


def draw(seed, seconds):
    """The plan of a seed."""
    rng = random.Random(seed)
    possible = [name for name in KINDS if rng.random() < 0.35]
    if rng.random() < 0.25:  # nothing is wrong but what users and signals do: the rate of each ramp is judged
        possible = list(ORDERLY)
    rate_per_s = rng.choice((0.3, 1.0, 3.0))
    slow = rng.random() < 0.3
    events, time_s = [], 2.0
    events.append(Event(2.0, "arm"))
    stream = rng.random() < 0.4
    if stream:
        events.insert(0, Event(1.8, "stream", (rng.choice((60.0, 120.0, 200.0)),)))
    time_s = rng.choice(PROLOGUES)(rng, time_s, events)
    while possible:
        time_s += rng.expovariate(rate_per_s)
        if time_s > seconds - SETTLED_S:
            break
        weights = [KINDS[name][0] for name in possible]
        name = rng.choices(possible, weights)[0]
        events.append(Event(time_s, name, KINDS[name][1](rng)))
        if rng.random() < 0.5:  # what meets it: at once, or while it lasts
            delay_s = rng.uniform(0.0, 0.02) if rng.random() < 0.5 else rng.uniform(0.1, 0.8)
            events.append(Event(time_s + delay_s, rng.choice(("disarm", "stop", "stop", "arm", "heal"))))
        if rng.random() < 0.4:
            time_s += rng.uniform(0.3, 1.5)
            if rng.random() < 0.3:
                events += _meeting(rng, time_s + 0.5)
            events += [Event(time_s, "heal"), Event(time_s + 0.3, "reset"), Event(time_s + 0.5, "start"),
                       Event(time_s + 1.7, "arm")]  # fmt: skip
            if rng.random() < 0.2:
                events.append(Event(time_s + 1.7 + rng.uniform(0.0, 0.006), "urge", ("stop",)))
            time_s += 1.8
    events.sort(key=lambda event: event.time_s)
    return Plan(
        seed, seconds,
        rate_Hz=rng.choice((100, 200, 200, 400)),
        reference="stream" if stream else "sine",
        recorder=rng.random() < 0.3,
        metrics=rng.random() < 0.3,
        drift=rng.random() < 0.3,
        frequency_Hz=rng.choice((0.5, 1.0, 4.0)),
        latency_ns=(20_000, 30_000) if not slow else (60_000, 1_500_000),
        wire="rtu" if rng.random() < 0.25 else "tcp",
        events=tuple(event for event in events if event.time_s < seconds - 0.5),
    )  # fmt: skip
