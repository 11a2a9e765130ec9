"""A pure delay lies between command and reading.

Forward    y(t) = F(t - delay), straight between samples; F(0) before the record.
Inverse    Take the reference earlier by the delay, fractions of a tick included. This needs preview.
Signature  An error in proportion to dF/dt, corners unchanged. Look-alikes: electrical_lag and sensor_filter round
           corners, clock_skew grows with time.
Location   Acquisition.
Valid      Half a sample to 0.5 s. Below 1.5 samples it is indistinguishable from a lag or a filter.
Source     T. I. Laakso, V. Valimaki, M. Karjalainen and U. K. Laine (1996), Splitting the Unit Delay,
           doi:10.1109/79.482137; piezod/effects/README.md, "Transport delay".
"""

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import LATE, Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Preview


@numba.njit(cache=True, nogil=True)
def earlier(x: Array, k: int, samples: float) -> float:
    """Value of `x` at k - `samples`, straight between samples; before the record its first value.

    Parameters
    ----------
    x
        Record, shape (N,).
    k
        Index of a sample, 0 to N - 1.
    samples
        Delay [samples], at least 0.
    """
    position = max(k - samples, 0.0)
    whole = int(position)
    if whole >= x.size - 1:
        return float(x[x.size - 1])
    part = position - whole
    return float(x[whole] + part * (x[whole + 1] - x[whole]))


@numba.njit(cache=True, nogil=True)
def _run(x: Array, samples: float) -> Array:
    out = np.empty(x.size)
    for k in range(x.size):
        out[k] = earlier(x, k, samples)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Delayed reading, shape (N,) [N].

    `signal` is the reading [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return _run(signal, values["delay_s"] / context.dt_s)


EFFECT = Effect(
    name="transport_delay",
    title="transport delay",
    location=Location.ACQUISITION,
    form="linear",
    parameters=(Parameter("delay_s", "s", 0.0, 0.5, Search((3e-3, 3e-2))),),
    forward=forward,
    handling="compensated",
    preview=Preview(lambda values: values["delay_s"], shifts=True),
    docstring=__doc__,
    separate_by="the edge of a step at the highest sampling rate, or the phase of a chirp: straight in frequency",
    plausible=lambda values, record: values["delay_s"] >= LATE * record.dt_s,
    checks=Checks(values={"delay_s": 0.0305}),
)
