"""What a model expects the load cell to read, and the force that stands behind a reading.

The forward chain is stepped with the voltage that was really written, by the same commit that the compensator makes;
behind it follow the load cell's effects, which are never driven against:

    force       plays, creep, gain -> force law -> curved law -> gap -> temperature -> mode
    expected    force -> leakage -> low-pass -> coupling of the drive -> hum -> delay
    corrected   reading + force - expected

So a correction takes from the model what the load cell lost, and leaves to the reading what the model does not know: no
noise is amplified (the inverse of a low-pass would), and nothing is integrated up (that of a leakage would). A reading
that has frozen keeps the difference that it had. It is for showing and comparing: interlocks judge the raw reading.
"""

import math
from collections.abc import Mapping

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.effects import EFFECTS
from piezod.effects.contact_gap import contact_step
from piezod.effects.feedthrough import coefficients, coupling_step
from piezod.effects.kernels import first_order_coefficients, first_order_step, second_order_matrices
from piezod.effects.mains_hum import HARMONICS
from piezod.effects.output_nonlinearity import law_step
from piezod.effects.sensor_filter import mode as mode_of_filter
from piezod.model import inverse_chain as at
from piezod.model.extended_compensator import ExtendedCompensator, acting_effects, ticks_late
from piezod.model.inverse_chain import commit_chain_step
from piezod.model.parameters import Model
from piezod.operators.dead_zone import dead_zone_step
from piezod.operators.play import play_value
from piezod.operators.prandtl_ishlinskii import HEADER
from piezod.recording.hold import HELD_ONE_SAMPLE, STRAIGHT

Array = NDArray[np.float64]

# Constants, then states, of the mode and the load cell.
MODE, LEAK_KEEP, LEAK_RAMP, LOW_PASS, KEEP, RAMP, COUPLING, COUPLING_KEEP, COUPLING_JUMP, LATE = range(10)
MODE_AT, LOW_PASS_AT = 10, 18  # M (4), before (2), now (2)
FORCE, FORCE_RATE, DRIVE, FIRST, LEAKED, SIGNAL, PASSED, PASSED_RATE, COUPLED = range(26, 35)
TICK, LAST, REPEATS, MISSING = range(35, 39)
SIZE = 39
FROZEN = 3.0  # equal readings in a row
HUM_FOLLOWED_S = 1.0  # how fast amplitude and phase of the hum are followed


@numba.njit(cache=True)
def _second_order(cell: Array, start: int, y: int, before: float, now: float) -> float:
    """Advance two states by the matrices at `start`."""
    y0, y1 = cell[y], cell[y + 1]
    cell[y] = cell[start] * y0 + cell[start + 1] * y1 + cell[start + 4] * before + cell[start + 6] * now
    cell[y + 1] = cell[start + 2] * y0 + cell[start + 3] * y1 + cell[start + 5] * before + cell[start + 7] * now
    result: float = cell[y]
    return result


@numba.njit(cache=True)
def _force(packed: Array, chain: Array, zones: Array) -> float:
    """Force in front of the mode at the end of the tick that was committed last [N]."""
    stroke_V = play_value(packed, HEADER, int(packed[0]))
    count = (chain.size - at.FIRST) // 4
    for j in range(at.FIRST, at.FIRST + count):
        stroke_V += chain[j + 2 * count] * chain[j + 3 * count]
    force: float = dead_zone_step(zones, 0, zones.size // 2, chain[at.GAIN] * stroke_V) + packed[2]
    if chain[at.SPAN_N] > 0.0:
        span = chain[at.SPAN_N]
        force = span * law_step(force / span, chain[at.SQUARE], chain[at.CUBE], chain[at.LOW], chain[at.HIGH])
    if chain[at.GAP_N] > 0.0:
        force = contact_step(force, chain[at.GAP_N], chain[at.SOFT_N])
    force += chain[at.THERMAL_N]
    return force


@numba.njit(cache=True)
def _sense(cell: Array, history: Array, before: float, force: float, moved_V: float) -> float:
    """What the load cell makes of a force, without hum: the signal, then as late as it is read [N]."""
    signal = force
    if cell[LEAK_KEEP] > 0.0:
        cell[LEAKED] = first_order_step(cell[LEAKED], before, force, cell[LEAK_KEEP], cell[LEAK_RAMP])
        signal = force - (cell[LEAKED] - cell[FIRST])
    earlier, cell[SIGNAL] = cell[SIGNAL], signal
    if cell[LOW_PASS] == 1.0:
        cell[PASSED] = first_order_step(cell[PASSED], earlier, signal, cell[KEEP], cell[RAMP])
        signal = cell[PASSED]
    elif cell[LOW_PASS] == 2.0:
        signal = _second_order(cell, LOW_PASS_AT, PASSED, earlier, signal)
    if cell[COUPLING] != 0.0:
        cell[COUPLED] = coupling_step(cell[COUPLED], moved_V, cell[COUPLING_KEEP], cell[COUPLING_JUMP])
        signal += cell[COUPLING] * cell[COUPLED]
    tick, size = int(cell[TICK]), history.size
    history[tick % size] = signal
    cell[TICK] = tick + 1.0
    whole = int(cell[LATE])
    part = cell[LATE] - whole
    return float((1.0 - part) * history[(tick - whole) % size] + part * history[(tick - whole - 1) % size])


@numba.njit(cache=True)
def _hum(waves: Array, tick: float, turn: float, gain: float, missing: float) -> float:
    """The hum at a tick as it is followed so far; each harmonic, shape (H, 3): number, cosine, sine."""
    total = 0.0
    for h in range(waves.shape[0]):
        angle = waves[h, 0] * turn * tick
        total += waves[h, 1] * math.cos(angle) + waves[h, 2] * math.sin(angle)
    left = missing - total
    if abs(left) < math.inf:
        for h in range(waves.shape[0]):
            angle = waves[h, 0] * turn * tick
            waves[h, 1] += 2.0 * gain * left * math.cos(angle)
            waves[h, 2] += 2.0 * gain * left * math.sin(angle)
    return total


@numba.njit(cache=True)
def _begin(cell: Array, history: Array, force: float) -> None:
    """Rest at a force."""
    for place in (FORCE, DRIVE, FIRST, LEAKED, SIGNAL, PASSED):
        cell[place] = force
    history[:] = force


@numba.njit(cache=True)
def expect_run(
    packed: Array,
    chain: Array,
    zones: Array,
    cell: Array,
    history: Array,
    waves: Array,
    turn: float,
    gain: float,
    voltage_V: Array,
    reading_N: Array,
    expected_N: Array,
    corrected_N: Array,
) -> None:
    """One tick after the other: the voltage of a tick and the reading at its end."""
    if cell[TICK] == 0.0:
        _begin(cell, history, _force(packed, chain, zones))
    for k in range(voltage_V.size):
        before_V, before = chain[at.APPLIED_V], cell[FORCE]
        commit_chain_step(packed, chain, voltage_V[k])
        force, drive = _force(packed, chain, zones), cell[DRIVE]
        cell[DRIVE] = force
        if cell[MODE] > 0.0:
            force = _second_order(cell, MODE_AT, FORCE, drive, force)
        cell[FORCE] = force
        read = _sense(cell, history, before, force, chain[at.APPLIED_V] - before_V)
        missing = reading_N[k] - read
        if waves.shape[0] > 0:
            hum = _hum(waves, cell[TICK], turn, gain, missing)
            read += hum
            missing -= hum
        cell[REPEATS] = cell[REPEATS] + 1.0 if reading_N[k] == cell[LAST] else 0.0
        cell[LAST] = reading_N[k]
        if cell[REPEATS] + 1.0 < FROZEN and abs(missing) < math.inf:
            cell[MISSING] = missing
        expected_N[k] = read
        corrected_N[k] = force + cell[MISSING]


class ExpectedReading:
    """A model stepped beside the bench.

    Parameters
    ----------
    model
        With its effects. Those that no inverse exists for are left out: what they do is then in the difference.
    dt_s
        Tick period [s].

    Raises
    ------
    ModelError
        The model's operator has no inverse.
    """

    def __init__(self, model: Model, dt_s: float) -> None:
        found = acting_effects(model)
        refused = [name for name in found if EFFECTS[name].handling == "refused"]
        self._chain = ExtendedCompensator(model, dt_s, refused)
        thresholds, weights = model.hysteresis.operator().dead_zones
        self._zones = np.concatenate((thresholds, weights))
        hum = next((one.parameters for one in model.effects if one.name == "mains_hum"), {})  # there again, other phase
        self._cell, self._waves = _cell(model, found, dt_s, self._chain.delay_s), _waves(hum)
        self._history = np.zeros(math.ceil(self._cell[LATE]) + 2)
        self._turn = 2.0 * math.pi * hum.get("frequency_Hz", 0.0) * dt_s
        self._gain = dt_s / HUM_FOLLOWED_S

    def reset(self) -> None:
        """Back to the model's start state, at rest; what is known of the hum stays."""
        self._chain.reset()
        self._cell[FORCE:] = 0.0
        self._cell[LAST] = math.nan

    def take(self, voltage_V: Array, reading_N: Array, temperature_C: float = math.nan) -> tuple[Array, Array]:
        """Readings that are expected, and the force behind those that came, each of shape (N,) [N].

        Parameters
        ----------
        voltage_V
            Written, one a tick, shape (N,) [V].
        reading_N
            At the end of each tick, shape (N,) [N]; nan where there was none.
        temperature_C
            Read last; slow, so that one value serves them all [degC].
        """
        self._chain.feel(temperature_C)
        expected, corrected = np.empty(voltage_V.size), np.empty(voltage_V.size)
        expect_run(
            *self._chain.arrays,
            self._zones,
            self._cell,
            self._history,
            self._waves,
            self._turn,
            self._gain,
            np.ascontiguousarray(voltage_V, dtype=np.float64),
            np.ascontiguousarray(reading_N, dtype=np.float64),
            expected,
            corrected,
        )
        return expected, corrected


def _cell(model: Model, found: Mapping[str, Mapping[str, float]], dt_s: float, delay_s: float) -> Array:
    """Constants of the mode and the load cell, states at 0, shape (SIZE,)."""
    cell = np.zeros(SIZE)
    cell[LAST] = math.nan
    smooth = any(EFFECTS[name].smooths for name in found if EFFECTS[name].location < EFFECTS["resonance"].location)
    hold = STRAIGHT if smooth else HELD_ONE_SAMPLE
    if mode := found.get("resonance"):
        cell[MODE] = 1.0
        cell[MODE_AT : MODE_AT + 8] = _flat(mode["frequency_Hz"], mode["damping_ratio"], dt_s, hold.number)
        hold = STRAIGHT
    if leak := found.get("charge_leakage"):
        cell[LEAK_KEEP], cell[LEAK_RAMP] = first_order_coefficients(leak["time_constant_s"], dt_s, hold.number)
    if low_pass := found.get("sensor_filter"):
        cell[LOW_PASS] = max(1.0, round(low_pass.get("order", 1.0)))
        time_s = 0.5 / math.pi / low_pass["cutoff_Hz"]
        cell[KEEP], cell[RAMP] = first_order_coefficients(time_s, dt_s, hold.number)
        cell[LOW_PASS_AT : LOW_PASS_AT + 8] = _flat(*mode_of_filter(low_pass), dt_s, hold.number)
    if coupling := found.get("feedthrough"):
        cell[COUPLING] = coupling["coefficient_N_s_per_V"]
        runs_on = "electrical_lag" in found or "slew_limit" in found or model.hold.straight
        held = (
            STRAIGHT if runs_on else HELD_ONE_SAMPLE
        )  # as in the fit, which may take a held command for a straight one
        cell[COUPLING_KEEP], cell[COUPLING_JUMP] = coefficients(coupling.get("rise_s", 0.0), dt_s, held.number)
    lag_s = found.get("electrical_lag", {}).get("time_constant_s", 0.0)
    cell[LATE] = ticks_late(delay_s, lag_s, dt_s)
    return cell


def _flat(frequency_Hz: float, damping_ratio: float, dt_s: float, hold: float) -> Array:
    """M (4), `before` (2) and `now` (2) of `second_order_matrices`."""
    matrix, before, now = second_order_matrices(frequency_Hz, damping_ratio, dt_s, hold)
    return np.concatenate((matrix.ravel(), before, now))


def _waves(hum: Mapping[str, float]) -> Array:
    """Harmonics of the hum that the model knows of, none of them followed yet, shape (H, 3)."""
    if not hum:
        return np.zeros((0, 3))
    harmonics = [1, *(h for h in HARMONICS if hum.get(f"sine_{h}", 0.0) or hum.get(f"cosine_{h}", 0.0))]
    waves = np.zeros((len(harmonics), 3))
    waves[:, 0] = harmonics
    return waves
