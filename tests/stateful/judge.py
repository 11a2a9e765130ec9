"""The judge of a sequence: what the amplifier's output and the answers of the service may be, whatever has happened."""

import time

from tests.faults.live_bench import SLEW_V_PER_S, TICK_MS, TIMING
from tests.faults.probe import STILL_MS

REST_V = 0.5  # largest output that counts as rest
ARMED_WITHIN_V = 2.0  # arming.readback_within_V: largest output at which an arm may be accepted
RANGE_V = 140.0
RAMP_DOWN_V_PER_S = 200.0  # slower than the ramps of a stop and of the device, so that haste is seen
STEADY_FROM_V = 10.0
STEADY_SHARE = 0.8  # of the time that a ramp takes at its rate; the reference may have fallen before it began
MACHINE_S = 1.5  # for a command on its way through the processes of a machine with other work
REST_WITHIN_S = RANGE_V / RAMP_DOWN_V_PER_S + 1e-3 * (TIMING["comm_loss_ms"] + TIMING["device_watchdog_ms"]) + MACHINE_S
ANSWER_WITHIN_S = {
    "status": 3.0,
    "stop": 3.0,
    "disarm": 3.0,
    "stop socket": 0.5,  # whatever the event loop, the log and the files do
}  # with a thousand idle clients, 0.4 to 0.8 s were measured
TRIP_MARGIN_N = 25.0  # noise of the reading, and the force that is left on the stack at 0 V
TRIPPED_WITHIN_S = 0.5
STATUS_S = 0.5
MOST_ERROR_N = 125.0  # tracking_trip_N, and the noise of the reading
ERROR_WITHIN_S = 1.0  # tracking_trip_ms, with time right between
COMMANDED_WITHIN_S = 3.0  # age of the last set point of a service that shows fresh values of a driven bench


class ViolationError(AssertionError):
    """The service did what it must never do."""


class Judge:
    """Judges a bench after each step.

    Attributes
    ----------
    may_drive
        Whether an arm that was not refused allows an output above rest.
    excused
        What injected faults excuse. `reading`: the service sees another force. `writes`: the device ignores it.
        `foreign`: the output jumped to a set point of another client, or to one that it had ignored.
    rest_due
        Time [ns, monotonic] and reason of the command, signal or kill that must bring the output to rest, or None.
    trip_N
        Force trip that the service has acknowledged.
    not_judged
        Number of envelope violations while this machine stood still, which no slew limit of the service can avoid.
    """

    def __init__(self, bench, probe):
        self.bench, self.probe = bench, probe
        self.not_judged, self._wrong = 0, []
        self.begin()

    def begin(self):
        """Start a sequence with a bench at rest."""
        self.may_drive = False
        self.rest_due = None
        self.trip_N = 360.0
        self.excused = set()
        self._armed_s, self._steady, self._disturbed = 0.0, None, False
        self._above_since_s = self._far_since_s = None
        self.new_service(len(self.bench.service.log_lines))
        self._last_ns = time.monotonic_ns()
        self.report()
        self.bench.device.ask("mark")
        self._wrong = []

    def report(self):
        """A report of the device; the violations of the envelope that it names are judged with the next step."""
        report = self.bench.device.ask("report")
        self._wrong += report["wrong"]
        return report

    def new_service(self, log_start=0):
        """The log of the service is judged from this line on."""
        self._log_start = log_start

    def expect_rest(self, reason, *, steadily=False):
        """The output must come to rest from now on; `steadily`: at the rate of a ramp, unless `disturb` is called."""
        if self.rest_due is not None:
            self.disturb()
            return
        report = self.report()
        if steadily and not self._disturbed and report["output_V"] > STEADY_FROM_V:
            self._steady = (report["now_ns"], report["output_V"], reason)
        self.rest_due = (time.monotonic_ns(), reason)

    def disturb(self):
        """Something may make each ramp of this sequence faster: a device fault, another signal, a stop."""
        self._steady, self._disturbed = None, True

    def sent_arm(self):
        """An arm was sent, which has not been refused."""
        self.may_drive, self._armed_s = True, time.monotonic()

    def accepted_arm(self, report):
        """An arm was accepted, some time after this report of the device."""
        output_V = report["output_V"]
        since_s = 1e-9 * (time.monotonic_ns() - report["now_ns"])
        if abs(output_V) > ARMED_WITHIN_V + SLEW_V_PER_S * since_s and "foreign" not in self.excused:
            raise ViolationError(f"an arm was accepted at {output_V:.2f} V")
        self.rest_due = None
        self.sent_arm()

    def answered(self, command, seconds):
        """A command was answered after this time."""
        limit_s = ANSWER_WITHIN_S.get(command)
        if limit_s is not None and seconds > limit_s and not self._stood_still():
            raise ViolationError(f"{command} was answered after {seconds:.2f} s, must be within {limit_s} s")

    @property
    def waits(self):
        """Whether the output has yet to come to rest."""
        return self.rest_due is not None

    def judge(self, state, status=None):
        """Judge the time since the last call.

        Parameters
        ----------
        state
            State that the service reports; None if unknown.
        status
            Its whole status; None without an answer.
        """
        report = self.report()
        self.bench.device.ask("mark")
        wrong, self._wrong = self._wrong, []
        still = self._stood_still() or report["behind_ms"] > TICK_MS
        self._last_ns = report["now_ns"]
        if wrong and "foreign" not in self.excused:
            if not still:
                raise ViolationError(f"output outside its envelope: {'; '.join(wrong)}")
            self.not_judged += 1
        at_rest = report["rest_ns"] is not None
        if not self.may_drive and report["highest_V"] > REST_V and "foreign" not in self.excused:
            raise ViolationError(f"output {report['highest_V']:.2f} V without an accepted arm, state {state}")
        shown = time.monotonic() - self._armed_s > STATUS_S  # a status follows an arm by the time of a poll
        if at_rest and shown and state in ("DISARMED", "FAULT", "gone"):
            self.may_drive = False
            self.excused.discard("foreign")
        self._judge_rest(report, at_rest, state)
        self._judge_trip(report, state)
        if status is not None and not status["stale"]:
            self._judge_error(status)
            self._judge_age(report, state)
        if "Traceback (most recent call last)" in self.bench.service.log(self._log_start):
            raise ViolationError("a traceback in the log: " + self.bench.service.log(self._log_start)[-1500:])

    def _judge_rest(self, report, at_rest, state):
        if self.rest_due is None:
            return
        sent_ns, reason = self.rest_due
        if "writes" in self.excused:  # the device does not obey
            self.rest_due = (report["now_ns"], reason)
            return
        safe_before = report["foreign_ns"] > report["command_ns"] and abs(report["requested_V"]) <= REST_V
        if safe_before and state in ("DISARMED", "gone"):
            self.rest_due = None  # the service had written the safe voltage; what stands is another client's
        elif at_rest:
            self.rest_due = None
            self._judge_rate(report["rest_ns"])
        elif 1e-9 * (report["now_ns"] - sent_ns) > REST_WITHIN_S and not self._stood_still():
            raise ViolationError(
                f"output {report['output_V']:.2f} V {1e-9 * (report['now_ns'] - sent_ns):.2f} s after {reason}, "
                f"must be at rest within {REST_WITHIN_S:.2f} s"
            )

    def _judge_rate(self, rest_ns):
        steady, self._steady = self._steady, None
        if steady is None:
            return
        begun_ns, from_V, reason = steady
        least_s = STEADY_SHARE * from_V / RAMP_DOWN_V_PER_S
        if 1e-9 * (rest_ns - begun_ns) < least_s:
            raise ViolationError(
                f"from {from_V:.1f} V to rest in {1e-9 * (rest_ns - begun_ns):.3f} s after {reason}, at "
                f"{RAMP_DOWN_V_PER_S:g} V/s it takes at least {least_s:.3f} s"
            )

    def _judge_trip(self, report, state):
        above = report["force_N"] > self.trip_N + TRIP_MARGIN_N and state in ("RUNNING", "HOLD", "ARMING")
        if not above or self.excused:
            self._above_since_s = None
            return
        self._above_since_s = self._above_since_s or time.monotonic()
        if time.monotonic() - self._above_since_s > TRIPPED_WITHIN_S:
            raise ViolationError(
                f"{report['force_N']:.0f} N in state {state}, with an acknowledged trip at {self.trip_N:g} N"
            )

    def _judge_error(self, status):
        """A service that drives must not show a force far from its reference for long."""
        force_N, reference_N = status["force_N"], status["reference_N"]
        known = status["state"] == "RUNNING" and None not in (force_N, reference_N)
        if not known or abs(force_N - reference_N) <= MOST_ERROR_N:
            self._far_since_s = None
            return
        self._far_since_s = self._far_since_s or time.monotonic()
        if time.monotonic() - self._far_since_s > ERROR_WITHIN_S and not self._stood_still():
            raise ViolationError(
                f"RUNNING with a force of {force_N:.0f} N at a reference of {reference_N:.0f} N for {ERROR_WITHIN_S} s"
            )

    def _judge_age(self, report, state):
        """Values that are shown as fresh while the bench is driven are not older than the last set point."""
        age_s = 1e-9 * (report["now_ns"] - report["command_ns"])
        if state in ("RUNNING", "HOLD") and age_s > COMMANDED_WITHIN_S and not self._stood_still():
            raise ViolationError(f"state {state} is shown as fresh, and the last set point is {age_s:.1f} s old")

    def _stood_still(self):
        return self.probe.worst_ms(self._last_ns) > STILL_MS
