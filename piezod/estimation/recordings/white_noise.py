"""White noise of a channel, from its second differences."""

import numpy as np
from numpy.typing import NDArray


def white_noise(bends: NDArray[np.float64]) -> float:
    """Standard deviation of white noise; 0 without a finite difference.

    The median ignores corners and steps of the channel. Of a normal distribution it is 0.6745 standard deviations, and
    a second difference of white noise has 6 times its variance.

    Parameters
    ----------
    bends
        Magnitudes of second differences, shape (N,), in the unit of the channel; nan where unknown.
    """
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends)) / (0.6745 * np.sqrt(6.0)) if bends.size else 0.0
