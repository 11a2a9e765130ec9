"""`Recording`: one time axis and named channels with units, common to every file format."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording import stretches
from piezod.recording.names import TIME

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["TIME", "Array", "Recording", "check_time"]

MOST_RESAMPLED = 2**29  # numbers that a resampled recording may hold: 4.3 GB as float64
UNIFORM_WITHIN = 0.01
"""Largest deviation of a sample period from the median, for uniformly sampled time [share of the median]."""


@dataclass(frozen=True)
class Recording:
    """Channels over one time axis.

    Parameters
    ----------
    time_s
        Time of the samples, strictly increasing, shape (N,) [s].
    channels
        Channel name to values, each shape (N,). A name ends in its unit: `force_N`, `voltage_V`. A missing sample is
        nan.
    metadata
        Keys and values that describe the recording.
    source
        Origin for messages, such as the path of a file.

    Raises
    ------
    RecordingError
        A channel has another length than `time_s`, or time does not strictly increase.
    """

    time_s: Array
    channels: dict[str, Array]
    metadata: dict[str, str] = field(default_factory=dict)
    source: str = "recording"

    def __post_init__(self) -> None:
        """Check the time axis and the lengths of the channels; take lists and whole numbers too."""
        object.__setattr__(self, "time_s", self._numbers(TIME, self.time_s))
        if not isinstance(self.channels, Mapping) or not all(isinstance(name, str) for name in self.channels):
            raise RecordingError(f"{self.source}: channels must be names with values, such as {{'force_N': force_N}}")
        numbers = {name: self._numbers(name, values) for name, values in self.channels.items()}
        object.__setattr__(self, "channels", numbers)
        for name, values in numbers.items():
            if values.shape != self.time_s.shape:
                raise RecordingError(f"{self.source}: {name} has {values.size} samples, time_s has {self.time_s.size}")
        check_time(self.source, self.time_s)

    def _numbers(self, name: str, values: ArrayLike) -> Array:
        if np.iscomplexobj(values):
            raise RecordingError(f"{self.source}: {name} holds complex numbers, must hold real ones")
        try:
            numbers: Array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{self.source}: {name} must hold numbers: {error}") from None
        if numbers.ndim != 1:
            raise RecordingError(f"{self.source}: {name} has the shape {numbers.shape}, must be one row of samples")
        return numbers

    @classmethod
    def from_frame(cls, frame: "pd.DataFrame", source: str = "frame") -> "Recording":
        """A recording from a pandas frame.

        Parameters
        ----------
        frame
            Columns are channels, such as `voltage_V` and `force_N`. Time is its column `time_s` [s], else its index, in
            seconds or as dates.
        source
            Origin for messages.

        Raises
        ------
        RecordingError
            It is no frame, a column does not hold numbers, or time does not strictly increase.

        Examples
        --------
        >>> again = piezod.Recording.from_frame(recording.frame())
        >>> bool((again.time_s == recording.time_s).all())
        True
        """
        if not hasattr(frame, "columns") or not hasattr(frame, "to_numpy"):
            raise RecordingError(f"{source}: is a {type(frame).__name__}, must be a pandas frame")
        columns = {}
        for name in frame.columns:
            try:
                columns[str(name)] = frame[name].to_numpy(dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise RecordingError(f"{source}: {name} must hold numbers: {error}") from None
        if TIME in columns:
            return cls(columns.pop(TIME), columns, {}, source)
        index = frame.index.to_numpy()
        if np.issubdtype(index.dtype, np.datetime64):
            index = (index - index[0]) / np.timedelta64(1, "s")
        return cls(index, columns, {}, source)

    def frame(self) -> "pd.DataFrame":
        """The recording as a pandas frame: channels over an index `time_s`.

        Raises
        ------
        ImportError
            pandas is not installed.

        Examples
        --------
        >>> list(recording.frame().columns)
        ['voltage_V', 'force_N']
        """
        import pandas as pd  # noqa: PLC0415  # optional

        return pd.DataFrame(self.channels, index=pd.Index(self.time_s, name=TIME))

    @property
    def dt_s(self) -> float:
        """Median sample period [s].

        Raises
        ------
        RecordingError
            The recording has fewer than two samples.
        """
        if self.time_s.size < 2:
            raise RecordingError(f"{self.source}: has {self.time_s.size} samples, a sample period needs 2")
        return stretches.median_period(self.time_s)

    @property
    def uniform(self) -> bool:
        """Whether every sample period deviates less than 1 % from the median."""
        if self.time_s.size < 2:
            return True
        shortest_s, longest_s = stretches.extreme_periods(self.time_s)
        return max(longest_s - self.dt_s, self.dt_s - shortest_s) < UNIFORM_WITHIN * self.dt_s

    def channel(self, name: str) -> Array:
        """Values of one channel, shape (N,), in the unit of its name; `-force_N` is the negative of `force_N`.

        Raises
        ------
        RecordingError
            The recording has no channel of this name; the message lists its channels.

        Examples
        --------
        >>> recording.channel("force_N").shape == recording.time_s.shape
        True
        """
        if name not in self.channels:
            if str(name).removeprefix("-") in self.channels:
                return -self.channels[name.removeprefix("-")]
            raise RecordingError(f"{self.source}: has no column {name}, has {', '.join(self.channels)}")
        return self.channels[name]

    def missing(self, channel: str) -> NDArray[np.bool_]:
        """True for each missing sample of a channel, shape (N,).

        Raises
        ------
        RecordingError
            The recording has no channel of this name.

        Examples
        --------
        >>> int(recording.missing("force_N").sum())
        0
        """
        return np.isnan(self.channel(channel))

    def part(self, rows: slice) -> "Recording":
        """Some of the rows, with all channels.

        Examples
        --------
        >>> recording.part(slice(0, 100)).time_s.size
        100
        """
        channels = {name: values[rows] for name, values in self.channels.items()}
        return Recording(self.time_s[rows], channels, self.metadata, self.source)

    def resampled(self, dt_s: float) -> "Recording":
        """Recording with a uniform time axis from the first sample on, every channel interpolated linearly.

        Values within a gap are nan. A gap is a pause of more than five median periods between present samples of a
        channel. Values before the channel's first sample and after its last one are nan too. There is no low-pass
        filter.

        Parameters
        ----------
        dt_s
            New sample period [s], above 0.

        Raises
        ------
        RecordingError
            The period is not above 0, or the result would hold more than `MOST_RESAMPLED` numbers.

        Examples
        --------
        >>> recording.resampled(0.01).time_s.size
        1200
        """
        if not isinstance(dt_s, int | float | np.number) or not 0 < dt_s < np.inf:
            raise RecordingError(f"{self.source}: cannot be resampled to {dt_s} s, must be above 0")
        longest_s = stretches.GAP_PERIODS * self.dt_s
        steps = (self.time_s[-1] - self.time_s[0]) / dt_s
        if steps * (1 + len(self.channels)) > MOST_RESAMPLED:
            raise RecordingError(f"{self.source}: {dt_s:g} s would make {steps:.3g} samples; take a longer period")
        at_s = self.time_s[0] + dt_s * np.arange(int(steps + 1e-6) + 1)
        at_s[-1] = min(at_s[-1], self.time_s[-1])  # a rounding error must not make the last value nan
        channels = {
            name: stretches.interpolated(self.time_s, values, at_s, longest_s) for name, values in self.channels.items()
        }
        return Recording(at_s, channels, dict(self.metadata), self.source)


def check_time(source: str, time_s: Array, first: int = 0, before_s: float = -np.inf) -> None:
    """Check that times strictly increase.

    Parameters
    ----------
    source
        Origin of the samples, for messages.
    time_s
        Times of consecutive samples, shape (N,) [s].
    first, before_s
        Number of the first of these samples, and the time of the sample before it [s].

    Raises
    ------
    RecordingError
        A time is not finite or not above its predecessor; the message names the first such sample.
    """
    if not np.isfinite(time_s).all():
        k = int(np.argmin(np.isfinite(time_s)))
        raise RecordingError(f"{source}: time_s of sample {first + k} is not finite; remove the row")
    backwards = time_s[1:] <= time_s[:-1]
    at_first = bool(time_s.size and time_s[0] <= before_s)
    if at_first or backwards.any():
        k = 0 if at_first else int(np.argmax(backwards)) + 1
        now_s, then_s = float(time_s[k]), float(time_s[k - 1] if k else before_s)
        remedy = "write time with more digits" if now_s == then_s else "cut the file there"
        remedy += ", or give --rate-Hz, where the samples are evenly spaced"
        raise RecordingError(
            f"{source}: time_s must strictly increase, sample {first + k} is at {now_s:.12g} s after {then_s:.12g} s; "
            f"{remedy}"
        )
