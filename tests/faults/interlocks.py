"""Each interlock is taken out in turn, and each of its rows of the fault list must then fail.

    python -m tests.faults --mutate [NAME ...]

A row that still passes does not show that this interlock acted: another one acted, with the same words. An interlock is
taken out as a hole of the past is put back (`tests/simulation/holes.py`), in a process of its own. Rows run in virtual
time or with a manually stepped clock. They pass with every interlock in place: `test_rows.py`, `test_faults.py`.
"""

import subprocess
import sys

from tests.simulation.holes import Hole, put_back


def _out(module, now, then, *rows):
    return Hole(f"piezod.{module}", now, then, "", rows)


NO_TRIP = "return Cause.NONE"
INTERLOCKS = {
    "force above its trip": _out("control.interlocks", "if force_N > self._max_N:", "if False:", "V6", "V7", "V24"),
    "force below its least": _out("control.interlocks", "elif force_N < self._min_N:", "elif False:", "V8"),
    "rate of the force": _out(
        "control.interlocks", "elif abs(force_N - self._force_N) > self._rate_N_per_ns * (now_ns - self._time_ns):",
        "elif False:", "V4",
    ),
    "leaky count of the force": _out(
        "control.interlocks", "            if self.count.level:\n                self.count.leak()\n"
        "            self.suspect = False", "            self.count.clear()\n            self.suspect = False",
        "V24", "V25",
    ),
    "stuck load cell": _out("control.interlocks", "return Cause.SENSOR_STUCK if stuck else Cause.NONE", NO_TRIP, "V2"),
    "voltage read back": _out(
        "control.interlocks", "return Cause.READBACK if self.count.add() else Cause.NONE", NO_TRIP, "P28", "P39",
    ),
    "tracking": _out(
        "control.interlocks", "return Cause.TRACKING if lasted_ns >= self.count.trips_at else Cause.NONE", NO_TRIP,
        "P29", "V26",
    ),
    "tracking at a rail": _out("control.loop", "if railed and abs(", "if False and abs(", "V28"),
    "clamped output": _out("control.interlocks", "return Cause.CLAMPED", NO_TRIP, "P35"),
    "output off": _out(
        "control.interlocks", "return Cause.OUTPUT_OFF if self.count.level >= SECOND_SAMPLE else Cause.NONE", NO_TRIP,
        "P34",
    ),
    "temperature": _out("control.interlocks", "return Cause.TEMPERATURE\n", NO_TRIP + "\n", "P30"),
    "lowest temperature": _out("control.interlocks", "if temperature_C >= self._low_C:", "if True:", "P33"),
    "frozen temperature": _out("control.interlocks", "return Cause.TEMPERATURE_SENSOR\n", NO_TRIP + "\n", "P40"),
    "heat": _out(
        "control.heat_interlock", "return Cause.OVERHEATED if self.power_W > self._max_W else Cause.NONE", NO_TRIP,
        "P32", "C13", "C14",
    ),
    "communication loss": _out("control.supervisor", "self.trip(Cause.COMM_LOSS)", "pass", "T3", "T4", "P17"),
    "count of failed exchanges": _out("control.supervisor", "self.trip(Cause.BAD_EXCHANGES)", "pass", "P36"),
    "invalid readings": _out("control.supervisor", "self.trip(Cause.BAD_READING)", "pass", "V1", "V3", "P26", "P31"),
    "fault of the amplifier": _out("control.supervisor", "self.trip(_device_fault(status))", "pass", "V13"),
    "watchdog of the device, after a silence": _out(
        "control.voltage_writer", "supervisor.trip(Cause.DEVICE_WATCHDOG)", "pass", "P9",
    ),
    "restart of the device": _out("control.voltage_writer", "supervisor.trip(Cause.DEVICE_RESTARTED)", "pass", "V14"),
    "missed ticks": _out("control.supervisor", "self.trip(Cause.MISSED_TICKS)", "pass", "M2"),
    "pause of the process": _out("control.supervisor", "        if self._watchdog_ns and pause_ns", "        return\n"
                                 "        if self._watchdog_ns and pause_ns", "M4", "M7"),
    "time of arming": _out("control.supervisor", "self.stop(Cause.ARMING_TIMEOUT)", "pass", "M11"),
    "sign check": _out("control.loop", "supervisor.trip(Cause.SIGN_CHECK)", "pass", "V9"),
    "exception in the controller": _out(
        "control.loop", '            self.failure = self.failure or f"{type(error).__name__}: {error}"\n'
        "            self.supervisor.trip(Cause.CONTROLLER)\n\n    def tick", "            pass\n\n    def tick", "R6",
    ),
    "comparison of the command": _out(
        "control.device_guard", "if now_ns < self._compare_ns or not self._link.holds_command:", "if True:",
        "P16", "P38", "S11",
    ),
    "voltage of the set point": _out(
        "transport.held_command", "return ExchangeResult.SETPOINT_CHANGED if number_agrees else",
        "return ExchangeResult.OK if number_agrees else", "P16", "P38", "S11",
    ),
    "number of the set point": _out(
        "transport.held_command", "else ExchangeResult.FOREIGN_COMMAND\n\n", "else ExchangeResult.OK\n\n", "P24",
    ),
    "settings of the device": _out(
        "transport.register_guard", "_OK if wire.payload[at : at + len(self.raw)] == self.raw else", "_OK if True else",
        "P18", "P25",
    ),
    "settings that cannot be read": _out(
        "control.device_guard", "if now_ns - self._confirmed_ns > UNCONFIRMED_NS:", "if False:", "P22",
    ),
    "identity at a connection": _out(
        "transport.modbus", "if result is not _OK or self._guard.is_verified():", "if True:", "P19",
    ),
    "identity while driving": _out(
        "transport.register_guard", "return ExchangeResult.WRONG_DEVICE", "return _OK", "P19", "P20",
    ),
    "echo of the command": _out("transport.tick_values", "return ExchangeResult.ECHO_MISMATCH", "pass", "P12"),
    "heartbeat": _out("transport.tick_values", "return ExchangeResult.HEARTBEAT_STOOD", "pass", "P26", "P27"),
    "heartbeat that runs backwards": _out("transport.tick_values", "if backwards or (", "if (", "P27"),
    "range of a reading": _out(
        "transport.tick_values", "return ExchangeResult.OUT_OF_RANGE if isfinite(value) else",
        "values[slot] = value\n                continue\n                return", "V1", "V3",
    ),
    "range of the voltage": _out(
        "control.limits", "return min(max(planned_V, self._low_V), self._high_V)", "return planned_V", "V11",
    ),
    "slew of the voltage": _out("control.limits", "        if voltage_V > high:\n", "        if False:\n", "M9"),
    "finite voltage": _out(
        "control.limits", "planned_V if isfinite(planned_V) else self._applied_V", "planned_V", "V10",
    ),
    "arming: identity": _out("control.arming", "    verify_identity(link)\n", "", "P45"),
    "arming: force at rest": _out(
        "control.arming", "if not bench.limits.force_min_N <= force_N <= bench.limits.force_trip_N:", "if False:",
        "P43",
    ),
    "arming: two forces agree": _out("control.arming", "if abs(second_N - first_N) > within_N:", "if False:", "P44"),
    "arming: a new sample": _out(
        "control.arming", '    raise CheckFailedError(\n        f"arming: {link.description}: heartbeat stays',
        '    str(\n        f"arming: {link.description}: heartbeat stays', "P42",
    ),
    "arming: output at rest": _out("control.arming", "    if isnan(readback_V):", "    if True:", "P41"),
    "arming: watchdog of the device": _out("control.arming", "    if found_ms != wanted_ms:", "    if False:", "P23"),
}  # fmt: skip


def failing(name):
    """Take an interlock out of the modules that are loaded from now on, and print those of its rows that fail."""
    hole = INTERLOCKS[name]
    put_back(hole)
    from tests.faults import run
    from tests.simulation.rows import phases, rows, run_row
    from tests.simulation.runs import warm_up

    simulated, listed = rows(), {fault.id: fault for fault in run.faults()}
    if {*hole.rows} & {*simulated}:
        warm_up()
    for row in hole.rows:
        if row in simulated:
            bad = next((bad for at_s in phases(simulated[row]) if (bad := run_row(simulated[row], at_s)[0])), [])
        else:
            assert listed[row].injector in run.IN_PROCESS, f"{row} runs in real time only"
            bad = run.run(listed[row], None, None).problems
        print(f"{row}: {bad[0] if bad else ''}", flush=True)


def mutate(names):
    """Print a table of the interlocks and of what their rows say without them; 1 if a row still passes."""
    survived = 0
    for name in names or INTERLOCKS:
        done = subprocess.run(
            [sys.executable, "-m", "tests.faults.interlocks", name], capture_output=True, text=True, check=False
        )
        found = dict(line.split(": ", 1) for line in done.stdout.splitlines() if ": " in line)
        for row in INTERLOCKS[name].rows:
            survived += not found.get(row)
            said = found.get(row) or ("SURVIVED" if row in found else f"NOT RUN {done.stderr.strip()[-100:]}")
            print(f"{name:42} {row:4} {said[:100]}", flush=True)
    count = sum(len(INTERLOCKS[name].rows) for name in names or INTERLOCKS)
    print(f"{len(names or INTERLOCKS)} interlocks taken out, {count - survived} of {count} rows fail without them")
    return int(survived > 0)


if __name__ == "__main__":
    failing(sys.argv[1])
