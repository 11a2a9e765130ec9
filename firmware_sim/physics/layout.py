"""Memory layout of the physics: one record of parameters, one record of state, and the status bits.

The compiled kernels read the fields by name (`state.output_V`), so that they read like the equations. Field names end
in their unit. `parameters.py` fills the parameters from a scenario. The kernels write the state; `bench.py` writes the
command, the watchdog and the fault bits.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

CREEP_MODES = 32  # slots: eight decades at four relaxations a decade
REVERSALS = 256  # slots: reversal extrema remembered; of two floats each
DELAY_SLOTS = 8192  # slots: physics steps of the transport delay
DROPOUTS = 16  # slots: spans of a frozen reading

STATUS_OUTPUT_ON = 1
STATUS_WATCHDOG_TRIPPED = 2
STATUS_CLAMPED = 4
STATUS_AMPLIFIER_FAULT = 8
STATUS_OVER_TEMPERATURE = 16
STATUS_MAINS_LOST = 32
OUTPUT_OFF_FAULTS = STATUS_AMPLIFIER_FAULT | STATUS_MAINS_LOST

_PARAMETER_FIELDS: dict[str, tuple[str, ...]] = {
    "clock": ("step_s", "samples_per_step"),
    "amplifier": ("minimum_V", "maximum_V", "converter_step_V", "lag_s", "slew_V_per_s", "readback_noise_V"),
    "watchdog": ("safe_V", "watchdog_ramp_V_per_s"),
    "stack": (
        "reversible",
        "width_scale_V",
        "width_weight",
        "bias_scale_V",
        "bias_weight",
        "full_V",
        "rate_growth",
        "rate_reference_V_per_s",
        "rate_path_V",
        "gain_change",
        "gain_time_s",
    ),
    "mechanics": (
        "full_N",
        "stiffening",
        "softening",
        "tare_N",
        "curvature",
        "gap_N",
        "touch_N",
        "friction_N",
        "presliding_N",
        "mode_rad_per_s",
        "mode_damping",
        "drift_N_per_K",
        "load_N",
        "load_on_s",
        "load_off_s",
        "load_rise_s",
        "vibration_N",
        "vibration_rad_per_s",
        "vibration_phase",
        "vibration_breathing",
    ),
    "load cell": (
        "leakage_s",
        "filter_rad_per_s",
        "filter_order",
        "feedthrough_N_s_per_V",
        "feedthrough_lag_s",
        "hum_N",
        "hum_rad_per_s",
        "hum_phase",
        "white_N",
        "coloured_N",
        "coloured_forgetting",
    ),
    "acquisition": ("converter_step_N", "delay_steps", "reading_low_N", "reading_high_N"),
    "temperature": ("mean_degC", "wander_K", "wander_rad_per_s", "wander_phase", "temperature_noise_K", "trip_degC"),
}

PARAMETERS = np.dtype(
    [(name, "f8") for names in _PARAMETER_FIELDS.values() for name in names]
    + [("creep_tau_s", "f8", (CREEP_MODES,)), ("creep_weight", "f8", (CREEP_MODES,)), ("creep_modes", "i8")]
    + [("dropout_from_s", "f8", (DROPOUTS,)), ("dropout_to_s", "f8", (DROPOUTS,)), ("dropouts", "i8")],
    align=True,
)

STATE = np.dtype(
    [
        ("steps", "i8"),  # physics steps since power-on
        ("sample_phase", "f8"),  # device samples, fraction until the next
        ("samples", "i8"),  # device samples since power-on: the heartbeat
        ("random", "u8"),
        ("spare_normal", "f8"),
        ("has_spare", "i8"),
        # firmware
        ("command_V", "f8"),
        ("watchdog_steps", "i8"),  # 0: off
        ("steps_since_command", "i8"),  # physics steps since the last command
        ("tripped", "i8"),
        ("fault_bits", "i8"),  # 8, 16 and 32, set from outside
        ("status", "i8"),
        # amplifier
        ("target_V", "f8"),
        ("output_V", "f8"),
        ("previous_output_V", "f8"),
        ("clamped", "i8"),
        # stack
        ("coercive_V", "f8"),
        ("field_V", "f8"),
        ("direction", "f8"),
        ("reversals", "i8"),
        ("reversal_V", "f8", (REVERSALS,)),
        ("reversal_output", "f8", (REVERSALS,)),
        ("irreversible", "f8"),
        ("hysteresis", "f8"),
        ("previous_hysteresis", "f8"),
        ("creep", "f8", (CREEP_MODES,)),
        ("stroke", "f8"),
        # mechanics
        ("contact_N", "f8"),
        ("previous_contact_N", "f8"),
        ("friction_N", "f8"),
        ("load_N", "f8"),
        ("drive_N", "f8"),
        ("mode_N", "f8"),
        ("mode_N_per_s", "f8"),
        ("true_force_N", "f8"),
        # load cell
        ("leaked_N", "f8"),
        ("previous_true_N", "f8"),
        ("feedthrough_V", "f8"),
        ("filter_in_N", "f8"),
        ("filter_N", "f8"),
        ("filter_N_per_s", "f8"),
        ("cell_N", "f8"),
        ("coloured_N", "f8"),
        # acquisition
        ("delay", "f8", (DELAY_SLOTS,)),
        ("arrived_N", "f8"),
        ("previous_arrived_N", "f8"),
        ("reading_N", "f8"),
        ("readback_V", "f8"),
        ("temperature_C", "f8"),
        ("temperature_reading_C", "f8"),
    ],
    align=True,
)

Records = NDArray[np.void]  # shape (1,), as a compiled loop takes them
Record: TypeAlias = Any  # one element of Records; the type checker does not know its fields
