"""What happens to the device, to the wire and at the control socket."""

import time

from hypothesis import strategies as st
from hypothesis.stateful import rule

from tests.faults.live_bench import TIMING
from tests.faults.running_faults import do
from tests.stateful.sequence import DRIVEN, Sequence

GUARD_PERIOD_S = 0.6  # the watchdog is read at least once in it
WATCHDOG_BACK_WITHIN_S = 3.0  # where faults of the wire must end first


class DeviceRules(Sequence):
    """Faults of the device and of the wire, and other clients."""

    # the device: after its faults the rate of a ramp is no longer judged ---------------------------------------------

    @rule(
        kind=st.sampled_from(["force", "offset", "reversed", "gain", "stuck", "frozen", "heartbeat_stuck", "readback"]),
        value=st.sampled_from([0.0, 1.0, 30.0, 500.0, "nan"]),
        count=st.sampled_from([1, 3, 0]),
    )
    def false_reading(self, kind, value, count):
        self._did("false reading", kind, value, count)
        self.judge.disturb()
        self.judge.excused.add("reading")
        self.bench.device.ask("reading_fault", kind=kind, value=value, count=count)

    @rule(code=st.sampled_from([1, 2, 4, 6]), count=st.sampled_from([1, 5, 400]))
    def refusal(self, code, count):
        self._did("refusal", code, count)
        self.judge.disturb()
        self.bench.device.ask("refuse", code=code, count=count)

    @rule()
    def ignored_writes(self):
        self._did("ignored writes")
        self.judge.disturb()
        self.judge.excused.add("writes")
        self.bench.device.ask("ignore_writes", ignored=True)

    @rule(what=st.sampled_from(["restart", "lose_settings"]))
    def restart(self, what):
        if self.service.control_killed or not self._alive():
            return  # only the device's watchdog is left, and it would be lost too
        self._did(what)
        self.judge.disturb()
        self.bench.device.ask("reading_fault")  # a firmware that starts anew has no false readings left
        self.bench.device.ask(what)
        self._until_the_watchdog_is_back()

    @rule(watchdog_ms=st.sampled_from([0, 5000]))
    def foreign_watchdog(self, watchdog_ms):
        if self.state not in DRIVEN or self.service.control_killed or "writes" in self.judge.excused:
            return  # only a service that drives reads the watchdog again, and only a device that obeys takes it
        self._did("foreign watchdog write", watchdog_ms)
        self.judge.disturb()
        do(self.bench, {"write_register": {"address": 110, "value": watchdog_ms}})
        self._until_the_watchdog_is_back()

    def _watchdog_is_kept(self):
        return self.judge.report()["watchdog_ms"] == TIMING["device_watchdog_ms"]

    def _until_the_watchdog_is_back(self):
        """A kill before the service could write the watchdog again leaves the changed one in force."""
        end_s = time.monotonic() + WATCHDOG_BACK_WITHIN_S
        time.sleep(GUARD_PERIOD_S)
        while self.state in DRIVEN and not self._watchdog_is_kept() and time.monotonic() < end_s:
            self.nothing_wrong_at_the_amplifier()
            time.sleep(0.05)

    @rule(above_V=st.sampled_from([2.0, 4.5]), times=st.sampled_from([1, 20]))
    def second_master(self, above_V, times):
        if self.state not in DRIVEN or self.service.control_killed:
            return  # an output that only another client drives is not the service's
        self._did("second master", above_V, times)
        self.judge.disturb()
        self.judge.excused.add("foreign")
        self.bench.device.ask("second_master", above_V=above_V, times=times, every_s=0.002)

    @rule()
    def amplifier_trips(self):
        self._did("amplifier trips")
        self.judge.disturb()
        self.tripped = True
        self.bench.device.ask("fault_bits", bits=8)

    @rule(
        fault=st.sampled_from(
            ["delay", "drop", "split", "corrupt", "reset", "close", "stall", "lag", "noise", "duplicate"]
        ),
        way=st.sampled_from(["request", "reply"]),
        count=st.sampled_from([1, 10]),
        by=st.sampled_from([0.002, 0.02]),  # a later command is applied late: see "What software cannot protect"
    )
    def wire(self, fault, way, count, by):
        self._did(f"wire {fault}", way, count, by)
        self.judge.disturb()
        self.bench.device.ask("rules", rules=[{"do": fault, "way": way, "count": count, "by": by}])

    @rule()
    def heal(self):
        self._did("heal")
        self._heal()

    # clients ----------------------------------------------------------------------------------------------------

    @rule(
        count=st.sampled_from([1, 12, 80]),
        sends=st.sampled_from([b"", b'{"command": "sta', b'{"command": "status"}\n' * 20, b"\xff\n" * 20, b"[" * 3000]),
    )
    def strangers(self, count, sends):
        self._did("clients that stay", count, sends[:12])
        self._connect(count, sends)

    @rule()
    def strangers_leave(self):
        self._did("clients leave")
        self._leave()
