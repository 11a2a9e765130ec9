"""A recording: one time axis and named channels with units, wherever it came from."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.recording import quality, stretches
from piezod.recording.names import TIME
from piezod.recording.stretches import Array
from piezod.recording.stuck import Stuck, stuck

__all__ = ["TIME", "Array", "Recording", "check_time"]

MOST_RESAMPLED = 2**29
"""Numbers that a resampled recording may hold: 4.3 GB."""

UNIFORM_WITHIN = 0.01
"""Share of the median period by which the periods of uniformly sampled time may differ from it."""


@dataclass(frozen=True)
class Recording:
    """Measured channels over one strictly increasing time axis.

    Parameters
    ----------
    time_s
        Shape (N,), strictly increasing [s].
    channels
        Name to values, each shape (N,); a name ends in its unit: `force_N`, `voltage_V`. A missing sample is nan.
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
        check_time(self.source, self.time_s)

    @property
    def dt_s(self) -> float:
        """Median sample period [s].

        Raises
        ------
        RecordingError
            There are not two samples.
        """
        if self.time_s.size < 2:
            raise RecordingError(f"{self.source}: has {self.time_s.size} samples, a sample period needs 2")
        return stretches.median_period(self.time_s)

    @property
    def uniform(self) -> bool:
        """Whether every sample period is within 1 % of the median."""
        if self.time_s.size < 2:
            return True
        shortest_s, longest_s = stretches.extreme_periods(self.time_s)
        return max(longest_s - self.dt_s, self.dt_s - shortest_s) < UNIFORM_WITHIN * self.dt_s

    def channel(self, name: str) -> Array:
        """Values of one channel, shape (N,), in the unit of its name.

        Raises
        ------
        RecordingError
            There is none of that name; those there are, are named.
        """
        if name not in self.channels:
            raise RecordingError(f"{self.source}: has no column {name}, has {', '.join(self.channels)}")
        return self.channels[name]

    def missing(self, channel: str) -> NDArray[np.bool_]:
        """Where a channel has no sample, shape (N,).

        Raises
        ------
        RecordingError
            There is no such channel.
        """
        return np.isnan(self.channel(channel))

    def stuck(self, channel: str, drive: str) -> Stuck:
        """Where a reading does not answer what drives it: frozen, or cut off at the ends of its range.

        Parameters
        ----------
        channel, drive
            Names of the reading and of what moves it, such as `force_N` and `voltage_V`.

        Raises
        ------
        RecordingError
            There is no such channel.
        """
        return stuck(self.channel(channel), self.channel(drive))

    def resampled(self, dt_s: float) -> "Recording":
        """Every channel interpolated linearly to a uniform time axis from the first sample on.

        Nothing is invented: between samples more than five (median) periods apart, where time pauses or samples are
        missing, and beyond a channel's first and last sample, the result is nan. No low-pass filter is applied.

        Parameters
        ----------
        dt_s
            The new sample period [s], above 0.

        Raises
        ------
        RecordingError
            The period is impossible, or would make more numbers than fit.
        """
        if not 0 < dt_s < np.inf:
            raise RecordingError(f"{self.source}: cannot be resampled to {dt_s} s, must be above 0")
        longest_s = stretches.GAP_PERIODS * self.dt_s
        steps = (self.time_s[-1] - self.time_s[0]) / dt_s
        if steps * (1 + len(self.channels)) > MOST_RESAMPLED:
            raise RecordingError(f"{self.source}: {dt_s:g} s would make {steps:.3g} samples; take a longer period")
        at_s = self.time_s[0] + dt_s * np.arange(int(steps + 1e-6) + 1)
        at_s[-1] = min(at_s[-1], self.time_s[-1])  # rounding must not lose the last sample
        channels = {
            name: stretches.interpolated(self.time_s, values, at_s, longest_s) for name, values in self.channels.items()
        }
        return Recording(at_s, channels, dict(self.metadata), self.source)

    def window(self, start_s: float, stop_s: float) -> "Recording":
        """The samples from `start_s` on and before `stop_s`; times stay as they are.

        Raises
        ------
        RecordingError
            None lies there.
        """
        first, after = (int(k) for k in np.searchsorted(self.time_s, [start_s, stop_s]))
        if first >= after:
            raise RecordingError(f"{self.source}: has no samples from {start_s:g} s to {stop_s:g} s")
        return self._part(slice(first, after))

    def split(self, fraction: float) -> "tuple[Recording, Recording]":
        """The first `fraction` of the samples, and the rest: one to identify on, one to hold out.

        Raises
        ------
        RecordingError
            One of the two would be empty.
        """
        first = round(fraction * self.time_s.size) if 0 < fraction < 1 else 0
        if not 0 < first < self.time_s.size:
            raise RecordingError(f"{self.source}: cannot be split at {fraction:g} of {self.time_s.size} samples")
        return self._part(slice(None, first)), self._part(slice(first, None))

    def quality(self) -> list[str]:
        """One line for each thing noteworthy: irregular time, gaps, missing, frozen and clipped samples."""
        return quality.describe(self)

    def _part(self, samples: slice) -> "Recording":
        channels = {name: values[samples] for name, values in self.channels.items()}
        return Recording(self.time_s[samples], channels, dict(self.metadata), self.source)


def check_time(source: str, time_s: Array, first: int = 0, before_s: float = -np.inf) -> None:
    """Refuse times that do not strictly increase.

    Parameters
    ----------
    source
        For messages.
    time_s
        Shape (N,) [s].
    first, before_s
        Number of the first of these samples, and the time of the one before it [s].

    Raises
    ------
    RecordingError
        The first sample at which it does not.
    """
    if not np.isfinite(time_s).all():
        k = int(np.argmin(np.isfinite(time_s)))
        raise RecordingError(f"{source}: time_s of sample {first + k} is not finite; remove the row")
    backwards = time_s[1:] <= time_s[:-1]
    at_once = bool(time_s.size and time_s[0] <= before_s)
    if at_once or backwards.any():
        k = 0 if at_once else int(np.argmax(backwards)) + 1
        now_s, then_s = float(time_s[k]), float(time_s[k - 1] if k else before_s)
        remedy = "write time with more digits" if now_s == then_s else "cut the file there"
        raise RecordingError(
            f"{source}: time_s must strictly increase, sample {first + k} is at {now_s:.12g} s after {then_s:.12g} s; "
            f"{remedy}"
        )
