"""Mains hum in the load cell's signal, with its harmonics.

Forward    F + amplitude (sin(a) + sum over h = 2 to 7 of sine_h sin(h a) + cosine_h cos(h a)), a = 2 pi f t + phase
Inverse    subtract it from the reading, its phase followed
Signature  narrow lines at 50 or 60 Hz and multiples, folded at half the sampling rate, at rest too; look-alike
           vibration has a frequency of its own
Seat       load cell
Valid      sampling fast enough for the line itself; harmonics above half the sampling rate appear folded
Source     H. W. Ott (1988), Noise Reduction Techniques in Electronic Systems, electric and magnetic pick-up;
           piezod/effects/README.md, "Mains hum"
"""

import math

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

TURN = 2.0 * math.pi
HARMONICS = (2, 3, 4, 5, 6, 7)


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Signal with the hum, shape (N,) [N]."""
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


EFFECT = Effect(
    name="mains_hum",
    title="mains hum",
    seat=Seat.LOAD_CELL,
    form="additive",
    parameters=(
        Parameter("amplitude_N", "N", 0.0, 1e3, starts=(0.3,)),
        Parameter("frequency_Hz", "Hz", 45.0, 65.0, starts=(50.0, 60.0)),
        Parameter("phase_rad", "rad", -TURN, 2.0 * TURN, starts=(0.0, 1.57, 3.14, 4.71), nuisance=True),
        *(
            Parameter(f"{part}_{h}", "1", -2.0, 2.0, starts=(0.0,), nuisance=True)
            for h in HARMONICS
            for part in ("sine", "cosine")
        ),
    ),
    forward=forward,
    handling="corrected in the reading",
    docstring=__doc__,
    why="it is no force: driving against it would make one",
    separate_by="a record at rest with the amplifier off, then with the cable of the load cell moved",
)
