"""A pure delay between command and reading.

Forward    y(t) = F(t - delay), straight between samples, F(0) before the record
Inverse    the reference is taken delay earlier, fractions of a tick included: preview
Signature  an error in proportion to dF/dt with corners as sharp as before; look-alikes electrical_lag and sensor_filter
           round them, clock_skew grows with time
Seat       acquisition
Valid      half a sample to 0.5 s; below 1.5 samples it cannot be told from a lag or a filter
Source     Laakso, Valimaki, Karjalainen and Laine (1996), Splitting the Unit Delay, doi:10.1109/79.482137; 1 to 20 ms
           over USB; piezod/effects/README.md, "Transport delay"
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def earlier(x: Array, k: int, samples: float) -> float:
    """Value of `x` `samples` before sample k, straight between samples; the first one before the record."""
    place = max(k - samples, 0.0)
    whole = int(place)
    if whole >= x.size - 1:
        return float(x[x.size - 1])
    part = place - whole
    return float(x[whole] + part * (x[whole + 1] - x[whole]))


@numba.njit(cache=True, nogil=True)
def _run(x: Array, samples: float) -> Array:
    out = np.empty(x.size)
    for k in range(x.size):
        out[k] = earlier(x, k, samples)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Reading that comes late, shape (N,) [N]."""
    return _run(signal, values["delay_s"] / context.dt_s)


EFFECT = Effect(
    name="transport_delay",
    title="transport delay",
    seat=Seat.ACQUISITION,
    form="linear",
    parameters=(Parameter("delay_s", "s", 0.0, 0.5, starts=(3e-3, 3e-2)),),
    forward=forward,
    handling="compensated",
    docstring=__doc__,
    separate_by="the edge of a step at the highest sampling rate, or the phase of a chirp: straight in frequency",
)
