"""The states of the control loop, what each may write, and the causes of a transition with their remedies.

`TRANSITIONS` is the whole state machine. The loop uses this table, the manual (`systemd/README.md`) shows it, and the
simulation compares every history with it. It has two rules:

- An event that the table does not have for the present state raises `CheckFailedError` and changes nothing. In the loop
  that is a fault of the controller: the output ramps down. A client that sent the command gets the error.
- A state writes what `MAY_WRITE` says, and a transition acts from the next write on.

The limits decide whether an event comes (`supervisor.py`). The order of authority sets the rate of a ramp
(`authority.py`). `STOP` and `TRIP` may come in each state: a stop has no precondition, and a device that is only read
may show anything. Only an operator causes `ARM` and `RESET`.
"""

from enum import Enum, IntEnum


class State(IntEnum):
    """State of the control loop in one tick.

    DISARMED and FAULT: it only reads. ARMING: it drives the sign check and the reset cycle, then approaches the first
    reference. RUNNING: it follows the reference. HOLD: it keeps the voltage. RAMP_DOWN: it drives to the safe voltage.
    """

    DISARMED = 0
    ARMING = 1
    RUNNING = 2
    HOLD = 3
    RAMP_DOWN = 4
    FAULT = 5


class Event(Enum):
    """Event that may change the state; its value is its name in the manual."""

    ARM = "arm"
    REACHED = "reference reached"
    LAPSED = "reference lapsed"
    LIVE = "reference live"
    STOP = "stop"
    TRIP = "fault"
    AT_REST = "at rest"
    LATCHED = "fault ramp ended"
    RESET = "reset"
    LEFT = "stop of a left output"


class Write(Enum):
    """Voltage that a state may write; its value stands in the manual."""

    NOTHING = "nothing"
    PLANNED = "planned voltage"
    HELD = "last voltage"
    LOWER = "lower voltage"


TRANSITIONS = {
    (State.DISARMED, Event.ARM): State.ARMING,
    (State.DISARMED, Event.LEFT): State.RAMP_DOWN,
    (State.DISARMED, Event.STOP): State.DISARMED,
    (State.DISARMED, Event.TRIP): State.DISARMED,
    (State.ARMING, Event.REACHED): State.RUNNING,
    (State.ARMING, Event.LAPSED): State.ARMING,
    (State.ARMING, Event.STOP): State.RAMP_DOWN,
    (State.ARMING, Event.TRIP): State.RAMP_DOWN,
    (State.RUNNING, Event.LAPSED): State.HOLD,
    (State.RUNNING, Event.STOP): State.RAMP_DOWN,
    (State.RUNNING, Event.TRIP): State.RAMP_DOWN,
    (State.HOLD, Event.LIVE): State.RUNNING,
    (State.HOLD, Event.LAPSED): State.HOLD,
    (State.HOLD, Event.STOP): State.RAMP_DOWN,
    (State.HOLD, Event.TRIP): State.RAMP_DOWN,
    (State.RAMP_DOWN, Event.AT_REST): State.DISARMED,
    (State.RAMP_DOWN, Event.LATCHED): State.FAULT,
    (State.RAMP_DOWN, Event.STOP): State.RAMP_DOWN,
    (State.RAMP_DOWN, Event.TRIP): State.RAMP_DOWN,
    (State.FAULT, Event.RESET): State.DISARMED,
    (State.FAULT, Event.LEFT): State.RAMP_DOWN,
    (State.FAULT, Event.STOP): State.FAULT,
    (State.FAULT, Event.TRIP): State.FAULT,
}
"""Next state, for each state and each event that may come in it."""

MAY_WRITE = {
    State.DISARMED: Write.NOTHING,
    State.ARMING: Write.PLANNED,
    State.RUNNING: Write.PLANNED,
    State.HOLD: Write.HELD,
    State.RAMP_DOWN: Write.LOWER,
    State.FAULT: Write.NOTHING,
}
DRIVING = tuple(state for state, write in MAY_WRITE.items() if write is not Write.NOTHING)
"""States that write a voltage in each tick."""


class Cause(IntEnum):
    """Cause of the last transition."""

    NONE = 0
    ARMED = 1
    REFERENCE_REACHED = 2
    STOPPED = 3
    REFERENCE_ENDED = 4
    REFERENCE_STALE = 5
    REFERENCE_LIVE = 6
    COMM_LOSS = 7
    OVER_FORCE = 8
    UNDER_FORCE = 9
    MISSED_TICKS = 10
    DEVICE_FAULT = 11
    DEVICE_WATCHDOG = 12
    SAFE = 13
    RESET = 14
    BAD_READING = 15
    FORCE_RATE = 16
    SENSOR_STUCK = 17
    TRACKING = 18
    READBACK = 19
    OVERHEATED = 20
    TEMPERATURE = 21
    SIGN_CHECK = 22
    STOOD_STILL = 23
    DEVICE_RESTARTED = 24
    CONTROLLER = 25
    DEVICE_TOO_HOT = 26
    MAINS_LOST = 27
    ARMING_TIMEOUT = 28
    WRONG_DEVICE = 31
    WRONG_LOAD_CELL = 32
    SETTING_CHANGED = 33
    OUTPUT_OFF = 34
    CLAMPED = 35
    TEMPERATURE_SENSOR = 36
    BAD_EXCHANGES = 37
    FOREIGN_COMMAND = 38
    SETPOINT_CHANGED = 39


CAUSE_TEXT = {
    Cause.NONE: "started",
    Cause.ARMED: "armed",
    Cause.REFERENCE_REACHED: "first reference reached",
    Cause.STOPPED: "stop requested",
    Cause.REFERENCE_ENDED: "reference ended",
    Cause.REFERENCE_STALE: "reference stale; check its sender",
    Cause.REFERENCE_LIVE: "reference live again",
    Cause.COMM_LOSS: "no good exchange for limits.comm_loss_ms; check cable, device and timeout_s",
    Cause.OVER_FORCE: "force above limits.force_trip_N; check specimen, reference and load cell",
    Cause.UNDER_FORCE: "force below limits.force_min_N; check preload and load cell",
    Cause.MISSED_TICKS: "too many ticks missed in a row; lower rate_Hz or the load of this machine (piezod latency)",
    Cause.DEVICE_FAULT: "the amplifier reports a fault; read its display",
    Cause.DEVICE_WATCHDOG: "the device's watchdog tripped; check rate_Hz and limits.device_watchdog_ms",
    Cause.SAFE: "safe voltage reached",
    Cause.RESET: "fault reset",
    Cause.BAD_READING: "the device answers, but with no valid reading for limits.stale_after_ms; check load cell, "
    "converter range and heartbeat",
    Cause.FORCE_RATE: "force changed faster than limits.force_rate_trip_N_per_s; check load cell, cable and specimen",
    Cause.SENSOR_STUCK: "limits.stuck_samples equal force readings while the voltage moved; check load cell and cable",
    Cause.TRACKING: "force differs from its reference by more than limits.tracking_trip_N, or from what the written "
    "voltage gives; check load cell, specimen and model",
    Cause.READBACK: "the voltage read back is not the voltage written; look for a second master or a broken monitor",
    Cause.OVERHEATED: "the stack dissipates more than limits.dissipation_max_W; lower frequency or amplitude",
    Cause.TEMPERATURE: "temperature above limits.temperature_trip_degC; let it cool",
    Cause.SIGN_CHECK: "the force did not rise by arming.sign_check.rise_N; check polarity, cable and preload",
    Cause.STOOD_STILL: "the control process paused for longer than the device waits; find what stopped it",
    Cause.DEVICE_RESTARTED: "the device restarted, or its output dropped by itself; check its supply",
    Cause.CONTROLLER: "the controller failed; see the log",
    Cause.DEVICE_TOO_HOT: "the amplifier reports over-temperature; let it cool, check its fan",
    Cause.MAINS_LOST: "the amplifier reports a loss of mains; check its supply",
    Cause.ARMING_TIMEOUT: "the first reference was not reached within limits.arming_timeout_s; check the reference and "
    "its sender",
    Cause.WRONG_DEVICE: "another device, firmware or register map answers; nothing is written to it; check address, "
    "cable and adapter",
    Cause.WRONG_LOAD_CELL: "another device answers in place of the load cell; check its address, cable and adapter",
    Cause.SETTING_CHANGED: "the watchdog of the device was changed or cannot be read any more; look for a second "
    "master or a restart",
    Cause.OUTPUT_OFF: "the device reports its output as off while it is driven; check its enable input and supply",
    Cause.CLAMPED: "the device reports a clamped output for limits.clamped_trip_ms; compare its range with limits",
    Cause.TEMPERATURE_SENSOR: "the temperature is missing, below limits.temperature_low_degC, or frozen; check its "
    "sensor and cable",
    Cause.BAD_EXCHANGES: "too many failed exchanges (limits.failed_exchanges); check cable, device and timeout_s",
    Cause.SETPOINT_CHANGED: "the set point in the device is not the one written; look for a second master or a device "
    "that ignores writes",
    Cause.FOREIGN_COMMAND: "the device received commands of another program; end it, then arm again",
}

DEVICE_HAS_TAKEN_OVER = frozenset({Cause.DEVICE_WATCHDOG, Cause.DEVICE_RESTARTED, Cause.WRONG_DEVICE})
"""Causes after which no voltage is written: the device drives its output by itself, or it is another device."""

DANGERS = frozenset({Cause.OVER_FORCE, Cause.FORCE_RATE})
"""Causes after which the output moves at the slew limit. A force below its minimum is none: haste would add tension."""
