"""The mains couples into the signal of the load cell, with harmonics.

Forward    F + amplitude (sin a + H); a = 2 pi f t + phase;
           H = sum over h = 2 to 7 of sine_h sin(h a) + cosine_h cos(h a).
Inverse    On the reading: subtract it, with a phase that is followed.
Signature  Narrow lines at 50 or 60 Hz and multiples, folded at half the sampling rate, also at rest. Look-alike:
           vibration has another frequency.
Location   Load cell.
Valid      A sampling rate above twice the line frequency. Harmonics above half the sampling rate appear folded.
Source     H. W. Ott (1988), Noise Reduction Techniques in Electronic Systems, Wiley, electric and magnetic pick-up;
           piezod/effects/README.md, "Mains hum".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values, at_its_frequency
from piezod.effects.parameter import Parameter, Search, below_the_fastest_mode
from piezod.effects.tick import Memory, Tick, TickSetting

TURN = 2.0 * math.pi
HARMONICS = (2, 3, 4, 5, 6, 7)


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal with the hum, shape (N,) [N].

    `signal` is the signal of the load cell [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    angle = TURN * values["frequency_Hz"] * context.time_s + values.get("phase_rad", 0.0)
    hum = np.sin(angle)
    for h in HARMONICS:
        sine, cosine = values.get(f"sine_{h}", 0.0), values.get(f"cosine_{h}", 0.0)
        if sine != 0.0:
            hum += sine * np.sin(h * angle)
        if cosine != 0.0:
            hum += cosine * np.cos(h * angle)
    out: Array = signal + values["amplitude_N"] * hum
    return out


TICKS, TURN_PER_TICK, GAIN, COUNT, WAVES = range(5)  # memory; then number, cosine [N] and sine [N] of every harmonic
ESTIMATE_S = 1.0  # time constant of the estimates of amplitude and phase


def _memory(values: Values, setting: TickSetting) -> Array:
    """Memory with amplitudes of 0: every drive has another phase than the recording."""
    harmonics = [1, *(h for h in HARMONICS if values.get(f"sine_{h}", 0.0) or values.get(f"cosine_{h}", 0.0))]
    head = [0.0, TURN * values["frequency_Hz"] * setting.dt_s, setting.dt_s / ESTIMATE_S, len(harmonics)]
    return np.concatenate((head, np.ravel([(h, 0.0, 0.0) for h in harmonics])))


def _follow(own: Memory, _shared: Memory, difference_N: float) -> float:
    """Hum at this tick as estimated so far; then update the estimate, unless the difference is not finite."""
    own[TICKS] += 1.0
    end = WAVES + 3 * int(own[COUNT])
    hum_N = 0.0
    for k in range(WAVES, end, 3):
        angle = own[k] * own[TURN_PER_TICK] * own[TICKS]
        hum_N += own[k + 1] * math.cos(angle) + own[k + 2] * math.sin(angle)
    remainder_N = difference_N - hum_N
    if abs(remainder_N) < math.inf:
        for k in range(WAVES, end, 3):
            angle = own[k] * own[TURN_PER_TICK] * own[TICKS]
            own[k + 1] += 2.0 * own[GAIN] * remainder_N * math.cos(angle)
            own[k + 2] += 2.0 * own[GAIN] * remainder_N * math.sin(angle)
    return hum_N


EFFECT = Effect(
    name="mains_hum",
    title="mains hum",
    location=Location.LOAD_CELL,
    form="additive",
    parameters=(
        Parameter("amplitude_N", "N", 0.0, 1e3, Search((0.3,))),
        Parameter("frequency_Hz", "Hz", 45.0, 65.0, Search((50.0, 60.0)), shown_by=below_the_fastest_mode),
        Parameter("phase_rad", "rad", -TURN, 2.0 * TURN, Search((0.0, 1.57, 3.14, 4.71), nuisance=True)),
        *(
            Parameter(f"{part}_{h}", "1", -2.0, 2.0, Search((0.0,), nuisance=True))
            for h in HARMONICS
            for part in ("sine", "cosine")
        ),
    ),
    forward=forward,
    handling="corrected in the reading",
    tick=Tick(_memory, follow=_follow),
    docstring=__doc__,
    why="it is no force: driving against it would make one",
    separate_by="a record at rest with the amplifier off, then with the cable of the load cell moved",
    place=at_its_frequency,
    found_by="test",
    repeats=False,
    checks=Checks(values={"sine_2": 0.3, "cosine_3": 0.2, "sine_5": 0.1}, constant="varies"),
)
