"""Effects laid over a real recording, as if the bench had them.

The recorded output replaces the emulated stack. It passes the laws of the emulator for creep, mechanics, load cell and
converter. Each sample has `FINER` steps, with a cubic spline between samples. An electrical lag acts before the
stack: the recorded voltage becomes the lagged one, and the command is computed from it. A clamp, a slew limit, a rate
dependence and bias-dependent loops cannot be laid over, since the stack never received such voltages.

The load cell's own noise arises behind the mechanics. So only effects of the reading (`OF_THE_READING`) act on the
recorded output itself; the others act on its smooth course, and what that leaves is added again.

The strength of an effect is the root mean square of its change without the mean, in units of the residual. The
residual is that of the diagnosis of the unchanged recording.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from firmware_sim.errors import ConfigurationError
from firmware_sim.physics.acquisition import acquire
from firmware_sim.physics.layout import Record, Records
from firmware_sim.physics.load_cell import sense
from firmware_sim.physics.mechanics import load
from firmware_sim.physics.parameters import initial_state, parameter_record
from firmware_sim.physics.scenario import load_scenario
from firmware_sim.physics.stack import deform
from piezod.recording import Recording

FINER = 40  # physics steps for each sample
SEED = 11  # seed of the phases of mains, machine and room temperature
WIDE = 1e6  # converter range beyond any output
CLOSE = 0.02  # relative tolerance of the strength
NOISE_WINDOW = 9  # samples of the local cubic whose course carries no noise
WIDER, HALVINGS = 3.0, 14  # growth and bisections of the search for the factor
TEMPERATURE = "temperature_C"
LAG = "electrical_lag"


@dataclass(frozen=True)
class Overlay:
    """How an effect is laid over a recording.

    Parameters
    ----------
    values
        Function from a recording and a strength factor to the values for `firmware_sim`.
    parameter
        Name of the compared parameter.
    start
        First factor of the search; None: the strength is fixed.
    inverse
        Whether the parameter falls as the effect grows, as a cut-off does.
    alike
        Whether the emulated law uses the parameter as the catalogue defines it.
    """

    values: Callable[["BaseRecording", float], dict[str, object]]
    parameter: str
    start: float | None
    inverse: bool = False
    alike: bool = True


@dataclass(frozen=True)
class BaseRecording:
    """A recording without an overlaid effect, and its residual.

    Parameters
    ----------
    recording
        Evenly sampled, with an emulated room temperature.
    command, output
        Names of its channels.
    residual
        Residual of its diagnosis on held-out blocks [output unit].
    """

    recording: Recording
    command: str
    output: str
    residual: float

    @property
    def dt_s(self) -> float:
        """Spacing of the samples [s]."""
        return float(np.median(np.diff(self.recording.time_s)))

    @property
    def duration_s(self) -> float:
        """Duration of the record [s]."""
        return float(np.ptp(self.recording.time_s))

    @property
    def span(self) -> float:
        """Range of the output [output unit]."""
        return float(np.ptp(self.recording.channel(self.output)))


def _part(of: float) -> Callable[[BaseRecording], float]:
    return lambda bare: of * bare.duration_s


def _simple(
    effect: str,
    parameter: str,
    of: Callable[[BaseRecording], float],
    start: float,
    *,
    inverse: bool = False,
    alike: bool = True,
    **others: object,
) -> tuple[str, Overlay]:
    """An overlay with one parameter: `of` the recording, multiplied or divided by the factor."""

    def values(bare: BaseRecording, factor: float) -> dict[str, object]:
        rest = {name: value(bare) if callable(value) else value for name, value in others.items()}
        return {parameter: of(bare) / factor if inverse else of(bare) * factor, **rest}

    return effect, Overlay(values, parameter, start, inverse, alike)


def _residual(bare: BaseRecording) -> float:
    return bare.residual


def _sample(bare: BaseRecording) -> float:
    return bare.dt_s


def _per_speed(bare: BaseRecording) -> float:
    """Residual over the rate of the command [output unit s / command unit]."""
    return bare.residual / float(np.std(np.gradient(bare.recording.channel(bare.command), bare.dt_s)))


def _dropped(bare: BaseRecording, factor: float) -> dict[str, object]:  # without a strength
    places = [[part * bare.duration_s, part * bare.duration_s + 40.0 * bare.dt_s] for part in (0.21, 0.47, 0.74)]
    return {"places_s": places}


OVERLAYS = dict(
    (
        _simple(LAG, "time_constant_s", _sample, 4.0),
        _simple("creep", "per_decade", lambda _: 1.0, 0.02, from_s=0.1, to_s=1000.0),
        _simple("gain_drift", "relative_change", lambda _: -1.0, 0.05, over_s=lambda bare: bare.duration_s),
        _simple("output_nonlinearity", "curvature", lambda _: 1.0, 0.1),
        _simple("contact_gap", "gap_N", _residual, 5.0, alike=False, touch_N=lambda bare: 0.1 * bare.residual),
        _simple("friction", "force_N", _residual, 3.0, presliding_N=lambda bare: 0.1 * bare.span),
        _simple("resonance", "frequency_Hz", lambda bare: 0.1 / bare.dt_s, 1.0, inverse=True, damping_ratio=0.05),
        _simple("thermal_drift", "coefficient_N_per_K", _residual, 3.0),
        _simple("load_step", "step_N", _residual, 6.0, on_s=_part(0.4), off_s=_part(0.65)),
        _simple("vibration", "amplitude_N", _residual, 4.0, frequency_Hz=lambda bare: 0.1187 / bare.dt_s),
        _simple("charge_leakage", "time_constant_s", lambda bare: 10.0 * bare.duration_s, 1.0, inverse=True),
        _simple("sensor_filter", "cutoff_Hz", lambda bare: 0.05 / bare.dt_s, 1.0, inverse=True),
        _simple("feedthrough", "coefficient_N_s_per_V", _per_speed, 3.0, bandwidth_Hz=lambda bare: 0.25 / bare.dt_s),
        _simple("mains_hum", "amplitude_N", _residual, 4.0, frequency_Hz=50.0),
        ("sensor_dropout", Overlay(_dropped, "from_s", None)),
        _simple("quantisation", "step_N", _residual, 10.0),
        _simple("transport_delay", "delay_s", _sample, 3.0),
        _simple("clock_skew", "skew_ppm", lambda bare: 1e6 * bare.dt_s / bare.duration_s, 6.0),
    )
)
OF_THE_READING = {"sensor_filter", "mains_hum", "sensor_dropout", "quantisation", "transport_delay", "clock_skew"}
NOT_OVERLAID = "slew_limit, voltage_clamp, rate_dependent_hysteresis, noncongruent_minor_loops"


def scaled_overlay(name: str, bare: BaseRecording, strength: float) -> tuple[Recording, dict[str, object], float]:
    """A recording with an effect of the given strength.

    Parameters
    ----------
    name
        Name of the effect.
    bare
        The recording without the effect.
    strength
        Root mean square of the change without its mean, over the residual.

    Returns
    -------
    recording, values, size
        The changed recording, the values of the effect, and the reached strength, which can be lower.
    """
    how = OVERLAYS[name]

    def made(factor: float) -> tuple[Recording, dict[str, object], float]:
        values = how.values(bare, factor)
        recording = overlaid(bare, {name: values})
        return recording, values, _change(bare, recording, name) / bare.residual

    if how.start is None:
        return made(1.0)
    low = high = how.start
    while made(low)[2] > strength:
        low /= WIDER
    found = made(high)
    while found[2] < strength:
        weaker, high = found, WIDER * high
        try:
            found = made(high)
        except ConfigurationError:  # beyond the limits of the emulator
            return weaker
        if found[2] < (1.0 + CLOSE) * weaker[2]:  # the largest possible strength
            return weaker
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        found = made(middle)
        if abs(found[2] / strength - 1.0) < CLOSE:
            break
        low, high = (middle, high) if found[2] < strength else (low, middle)
    return found


def with_room_temperature(recording: Recording) -> Recording:
    """The recording with an emulated room temperature, as in every study."""
    time_s = recording.time_s - recording.time_s[0]
    temperature_C, _ = _run(time_s, np.zeros(time_s.size), np.zeros(time_s.size), {}, 1.0)
    return Recording(
        recording.time_s, dict(recording.channels) | {TEMPERATURE: temperature_C}, recording.metadata, recording.source
    )


def overlaid(bare: BaseRecording, effects: Mapping[str, Mapping[str, object]]) -> Recording:
    """The recording with these effects laid over its output; the temperature does not change."""
    recording = bare.recording
    time_s = recording.time_s - recording.time_s[0]
    command, output = recording.channel(bare.command), recording.channel(bare.output)
    if lag := effects.get(LAG):
        command = _before_lag(time_s, command, float(lag["time_constant_s"]))
    else:
        course = output if OF_THE_READING.issuperset(effects) else savgol_filter(output, NOISE_WINDOW, 3)
        _, changed = _run(time_s, course - course[0], command, effects, bare.span)
        output = course[0] + changed + (output - course)
    channels = dict(recording.channels) | {bare.command: command, bare.output: output}
    return Recording(recording.time_s, channels, recording.metadata, recording.source)


def _change(bare: BaseRecording, made: Recording, name: str) -> float:
    """Root mean square of the change without its mean; for a lag, scaled by the mean gain of the output."""
    if name != LAG:
        return float(np.std(made.channel(bare.output) - bare.recording.channel(bare.output)))
    earlier = made.channel(bare.command) - bare.recording.channel(bare.command)
    u, y = bare.recording.channel(bare.command), bare.recording.channel(bare.output)
    return float(np.std(earlier) * np.std(y) / np.std(u))


def _before_lag(time_s: np.ndarray, voltage: np.ndarray, time_constant_s: float) -> np.ndarray:
    """Commands from which a first-order lag makes these voltages; `tau du/dt = command - u` on the fine steps."""
    step_s = float(np.median(np.diff(time_s))) / FINER
    spline = CubicSpline(time_s, voltage)
    middle_s = time_s + 0.5 * step_s
    earlier, later = spline(middle_s - step_s), spline(middle_s)
    return 0.5 * (earlier + later) + time_constant_s * (later - earlier) / step_s


def _run(
    time_s: np.ndarray, output: np.ndarray, drive: np.ndarray, effects: Mapping[str, Mapping[str, object]], span: float
) -> tuple[np.ndarray, np.ndarray]:
    """Temperature [degC] and readings of the emulated chain behind a stack with the recorded output."""
    step_s = float(np.median(np.diff(time_s))) / FINER
    scenario = load_scenario(
        "stack",
        {
            "step_s": step_s,
            "sample_rate_Hz": 1.0 / step_s,
            "stack": {"irreversible": 0.0, "full_V": span},
            "mechanics": {"full_N": span, "stiffening": 0.0, "softening": 0.0},
            "load_cell": {"white_noise_N": 0.0, "converter_step_N": 0.0, "low_N": -WIDE, "high_N": WIDE},
            "effects": {name: dict(values) for name, values in effects.items() if name != LAG},
        },
    )
    generator = np.random.Generator(np.random.PCG64(SEED))
    parameters = parameter_record(scenario, generator)
    state = initial_state(parameters, generator)
    state[0]["feedthrough_V"] = drive[0]
    fine_s = np.arange(round(time_s[-1] / step_s) + 1) * step_s
    skew = scenario.effects.clock_skew
    ends = np.rint(time_s * (1.0 + 1e-6 * skew.skew_ppm if skew else 1.0) / step_s).astype(np.int64)
    rows = np.zeros((2, time_s.size))
    _pass(
        state,
        parameters,
        CubicSpline(time_s, output)(fine_s),
        np.interp(fine_s, time_s, drive),
        np.minimum(ends, fine_s.size - 1),
        rows,
    )
    return rows[0], rows[1]


@njit(cache=True)
def _pass(
    states: Records, parameter_sets: Records, output: np.ndarray, drive: np.ndarray, ends: np.ndarray, rows: np.ndarray
) -> None:
    """Pass a recorded output through the chain behind the stack; rows: temperature and reading at steps `ends`."""
    state, parameters = states[0], parameter_sets[0]
    step = 0
    for row in range(ends.size):
        while step <= ends[row]:
            _step(state, parameters, output[step], drive[step])
            step += 1
        rows[0, row] = state.temperature_reading_C
        rows[1, row] = state.reading_N


@njit(cache=True)
def _step(state: Record, parameters: Record, output: float, drive: float) -> None:
    """One physics step; `output_V` first holds the output of the stack, then the drive that couples into the signal."""
    state.steps += 1
    state.output_V = output
    deform(state, parameters)
    load(state, parameters)
    state.output_V = drive
    sense(state, parameters)
    acquire(state, parameters)
