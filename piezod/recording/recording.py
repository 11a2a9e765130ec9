"""A recording: one time axis and named channels with units, wherever it came from."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError

Array = NDArray[np.float64]

TIME = "time_s"


@dataclass(frozen=True)
class Recording:
    """Measured channels over one strictly increasing time axis.

    Parameters
    ----------
    time_s
        Shape (N,), strictly increasing [s].
    channels
        Name to values, each shape (N,); a name ends in its unit: `force_N`, `voltage_V`.
    metadata
        What the file says about itself.
    source
        Where it came from, for messages.

    Raises
    ------
    RecordingError
        Lengths differ, or time does not increase.
    """

    time_s: Array
    channels: dict[str, Array]
    metadata: dict[str, str] = field(default_factory=dict)
    source: str = "recording"

    def __post_init__(self) -> None:
        """Refuse an impossible time axis and unequal lengths."""
        for name, values in self.channels.items():
            if values.shape != self.time_s.shape:
                raise RecordingError(f"{self.source}: {name} has {values.size} samples, time_s has {self.time_s.size}")
        if not np.isfinite(self.time_s).all():
            raise RecordingError(f"{self.source}: time_s has a value that is not finite; remove the row")
        backwards = np.flatnonzero(np.diff(self.time_s) <= 0)
        if backwards.size:
            k = int(backwards[0]) + 1
            raise RecordingError(
                f"{self.source}: time_s must strictly increase, sample {k} is at {self.time_s[k]:g} s after "
                f"{self.time_s[k - 1]:g} s"
            )

    @property
    def dt_s(self) -> float:
        """Median sample period [s]."""
        return float(np.median(np.diff(self.time_s)))

    def channel(self, name: str) -> Array:
        """Values of one channel.

        Raises
        ------
        RecordingError
            There is none of that name; those there are, are named.
        """
        if name not in self.channels:
            raise RecordingError(f"{self.source}: has no column {name}, has {', '.join(self.channels)}")
        return self.channels[name]
