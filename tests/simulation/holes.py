"""Holes of the past, put back one by one: does the simulation find them, at which seed and time?

    python -m tests.simulation --hole NAME [--seeds N] [--seconds T]
    python -m tests.simulation --holes

A hole is a change of the source of one module, made while the module is loaded. No file changes.
"""

import sys
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from pathlib import Path


@dataclass(frozen=True)
class Hole:
    """A line of a module, and what stood there when the hole was open."""

    module: str
    now: str
    then: str
    source: str  # where the hole is listed or was mended
    rows: tuple[str, ...] = ()  # of the fault list, that find it

    def code(self, path):
        """Code of the module with the hole.

        Raises
        ------
        ImportError
            The place of the hole is not there once.
        """
        text = Path(path).read_text(encoding="utf-8")
        if text.count(self.now) != 1:
            raise ImportError(f"{self.module}: the place of the hole is there {text.count(self.now)} times")
        return compile(text.replace(self.now, self.then), path, "exec")


HOLES = {
    "arm after a stop": Hole(
        "piezod.session.command_queue",
        'if name == "arm" and requested_ns < self._arms_from_ns:', "if False:", "F3: a refused command never acts"),
    "an arm outranks the stop before it": Hole(
        "piezod.session.command_queue", '(OUTRANKED_NS if name == "stop" else 1)', "1", "H7: order of two channels"),
    "orphan drives on": Hole(
        "piezod.session.control_process",
        "if not processes.end_with_parent(signal.SIGTERM):", "if False:", "F8: the end of the parent is noticed"),
    "a second signal is haste": Hole(
        "piezod.session.control_process",
        "signals.handle(signal.SIGTERM, lambda *_: loop.request_stop())",
        "signals.handle(signal.SIGTERM, lambda *_: loop.request_stop(fast=loop.stopped))",
        "F7: one ramp at the configured rate"),
    "watchdog is not read again": Hole(
        "piezod.control.device_guard",
        "        if done_ns < self._due_ns and result == _OK:\n            return\n", "        return\n", "F5"),
    "old ticks are caught up": Hole(
        "piezod.control.rate_keeper",
        "            deadline += skipped * self._period_ns\n", "", "M1: skip, never catch up in a burst"),
    "no trip of the force": Hole(
        "piezod.daemon.service",
        'answer = await self._command("limits", bench.limits)', 'answer = "limits taken"', "F1: reload without effect"),
    "SIGTERM waits for the loop": Hole(
        "piezod.daemon.service",
        "        if self._channel.session is not None and self._channel.connected:\n"
        "            self._channel.session.stop()\n", "", "G1: SIGTERM does not reach the control process"),
    "urgent stop is lost": Hole(
        "piezod.session.control_process",
        "_urge(name, task, loop, commands)", "None", "G1: the stop socket has no effect"),
    "full socket refuses a stop": Hole(
        "piezod.daemon.control_socket",
        "if not place.may_send(command):", "if not place.served:", "F4: clients keep a stop out"),
    "perhaps written is not written": Hole(
        "piezod.control.voltage_writer",
        "limiter.perhaps_sent(link.written_V)", "pass", "P9: a voltage whose answer was lost may act"),
    "no look after a silence": Hole(
        "piezod.control.voltage_writer",
        "if self.output_uncertain or begun_ns - self._acknowledged_ns >= self._verify_after_ns:",
        "if False:", "M4: the device may have taken over"),
    "a restart is not noticed": Hole(
        "piezod.control.voltage_writer",
        "elif (reading.heartbeat - heartbeat) & 0xFFFF >= 0x8000 or self._has_dropped(reading.voltage_readback_V):",
        "elif False:", "V14: the device restarted"),
    "removed lock frees the bench": Hole(
        "piezod.daemon.service",
        "        if not self._lock.restore():", "        if False:", "G4: two masters of our own kind"),
    "no clamp of the voltage": Hole(
        "piezod.control.limits", "return min(max(planned_V, self._low_V), self._high_V)", "return planned_V",
        "V10: a plan outside the range"),
    "no limit of the slew": Hole(
        "piezod.control.limits", "        if voltage_V > high:\n", "        if False:\n",
        "V10: a jump of the reference"),
    "ramp down at the slew": Hole(
        "piezod.control.loop", "self._ramp_V if motion.to_safe", "inf if motion.to_safe", "F7: rate of a ramp"),
    "set point is not compared": Hole(
        "piezod.control.device_guard",
        "if now_ns < self._compare_ns or not self._link.holds_command:", "if True:", "P16: a second master"),
    "identity is not compared again": Hole(
        "piezod.transport.modbus", "if result is not _OK or self._guard.is_verified():", "if True:",
        "F6: another device after a reconnection"),
    "end of a stream is not noticed": Hole(
        "piezod.control.references.live",
        "live = received is not None and now_ns - received < self._stale_ns", "live = received is not None",
        "F2: age of a reference"),
    "arming waits for ever": Hole(
        "piezod.control.supervisor",
        "if self.state is State.ARMING and now_ns - self._armed_ns > self._planned_ns + self._arming_timeout_ns:",
        "if False:", "F2: ARMING has a time limit"),
    "no trip above the force limit": Hole(
        "piezod.control.interlocks",
        "        return cause if self.count.add() else Cause.NONE\n\n\nclass StuckInterlock",
        "        return Cause.NONE\n\n\nclass StuckInterlock", "V6: force above its limit"),
    "a reload loosens a limit while armed": Hole(
        "piezod.daemon.reload", "if looser := loosened_limit(old.limits, new.limits):", "if looser := '':",
        "C10: limits raised by reload while armed"),
    "a reload is taken while the control process starts": Hole(
        "piezod.daemon.service",
        "check_settled(connected=channel.connected, ended=channel.ended, problem=channel.problem)",
        "if not channel.connected:\n                self._bench = bench\n                self._wake.set()\n"
        '                return "configuration taken"',
        "F1: the old configuration drove"),
    "the arm of a start survives a stop": Hole(
        "piezod.daemon.service", "        self._arm_withdrawn = True\n", "", "F3: an arm that acts after a stop"),
    "a watchdog of before is a fault of the stop": Hole(
        "piezod.control.supervisor", "elif status & STATUS_WATCHDOG and not self._watchdog_of_before:",
        "elif status & STATUS_WATCHDOG and (not self._watchdog_of_before or self.state is not State.ARMING):",
        "R1: a stop ends with 0"),
    "removed files stay away without a device": Hole(
        "piezod.daemon.service", "if clock.monotonic() > self._files_seen_s + FILES_INTERVAL_S:",
        "if self._channel.connected and clock.monotonic() > self._files_seen_s + FILES_INTERVAL_S:",
        "G4: unreachable after its files were removed"),
    "old values are shown as good ones": Hole(
        "piezod.recording.age", "return age_s is None or age_s > max(STALE_AFTER_S, STALE_TICKS * dt_s)",
        "return age_s is None", "G11: values 8 s old without a word"),
    "a failed exchange gives values": Hole(
        "piezod.recording.age", 'rows["result"] == GOOD', 'rows["result"] >= GOOD', "H8: age of the row"),
    "a kill keeps the heat of before": Hole(
        "piezod.session.heat_file", "            self._path.unlink()\n        except", "        except",
        "F9: heat is forgotten"),
    "removed stop socket stays away": Hole(
        "piezod.daemon.stop_path", "if self._listener is None or self._listener.is_present:", "if True:",
        "G4: unreachable after its files were removed"),
    "an old command acts": Hole(
        "piezod.session.command_queue", "if age_s > VALID_FOR_S:", "if False:", "F3: a token expires"),
    "a comfort rule outranks the stop": Hole(
        "piezod.control.supervisor", "                return Demand.STOP\n",
        "                return Demand.SUSPECT if self.force.suspect else Demand.DISARM\n", "H1: a slower stop"),
    "a danger ramps down at leisure": Hole(
        "piezod.control.authority", "Demand.DANGER: Motion(to_safe=True, at_slew=True",
        "Demand.DANGER: Motion(to_safe=True, at_slew=False", "H1: the trip of a force"),
    "a command obeys no stop socket": Hole(
        "piezod.session.control_process", '        loop.request_stop(fast=name == "stop")\n', "        pass\n",
        "H4: the daemon has it, the commands have not"),
    "a lock that is held is taken": Hole(
        "piezod.session.lock", "        descriptors.lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)\n", "",
        "H11: a living holder taken for dead"),
    "a fault writes on": Hole(
        "piezod.control.loop", "        if not supervisor.driving:\n            result",
        "        if supervisor.state is State.DISARMED:\n            result", "G9: what FAULT must not write"),
    "a fault does not stop": Hole(
        "piezod.control.states", "(State.RUNNING, Event.TRIP): State.RAMP_DOWN",
        "(State.RUNNING, Event.TRIP): State.RUNNING", "G7: a check that is off while it is needed"),
}  # fmt: skip


class Loader(SourceFileLoader):
    """Loads a module with a hole."""

    hole = None

    def get_code(self, fullname):
        return self.hole.code(self.get_filename(fullname))


class Finder(MetaPathFinder):
    """Finds the module of a hole."""

    def __init__(self, hole):
        self._hole = hole

    def find_spec(self, fullname, path, target=None):
        if fullname != self._hole.module:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        loader = Loader(fullname, spec.origin)
        loader.hole = self._hole
        spec.loader = loader
        return spec


def put_back(hole):
    """Open a hole for the modules that are loaded from now on."""
    if hole.module in sys.modules:
        raise ImportError(f"{hole.module} is loaded already")
    sys.meta_path.insert(0, Finder(hole))
