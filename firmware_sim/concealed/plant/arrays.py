"""The array type of the concealed package: float64, any shape."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
