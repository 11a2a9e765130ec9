"""Time stamps that a logger rounded or wrote twice."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array

FEWEST = 16  # samples of a block in which repeated stamps can be understood; in fewer they are an error
ROUNDED_SHARE = 0.1  # Share of repeated stamps from which time was rounded. Below it, a row was written twice
EVENLY_WITHIN = 2.0
"""Largest distance of a rounded stamp from evenly spaced times [resolutions]: rounding, and a late block."""


class TimeStamps:
    """Makes the time of consecutive blocks of samples strictly increasing where stamps are repeated.

    Rounded stamps are spread over the resolution of the clock, evenly where the samples are even. Where a stamp
    is repeated here and there, its first row stays. Stamps that fall are left as they are.
    """

    def __init__(self) -> None:
        self._stamp_s = self._end_s = -np.inf
        self._rounded_to_s = 0.0
        self._dropped = 0

    @property
    def notes(self) -> list[str]:
        """Lines on the changes."""
        notes = []
        if self._rounded_to_s:
            notes.append(f"time is rounded to {self._rounded_to_s:.3g} s, the samples are spread between the stamps")
        if self._dropped:
            notes.append(f"samples with the time of the sample before, left out: {self._dropped}")
        return notes

    def cleaned(self, tables: Iterator[dict[str, Array]], time: str) -> Iterator[dict[str, Array]]:
        """The tables with strictly increasing time.

        Parameters
        ----------
        tables
            Blocks of columns, shape (N,) each.
        time
            Name of the column of time [s].
        """
        for table in tables:
            stamps_s = table[time]
            repeated = np.diff(stamps_s, prepend=self._stamp_s) == 0.0
            if not (np.isfinite(stamps_s).all() and (np.diff(stamps_s) >= 0.0).all()):
                yield table  # refused where it is read
                continue
            cleaned = table
            if self._are_rounded(repeated):
                cleaned = {**table, time: self._spread(stamps_s)}
            elif repeated.any() and (self._dropped or _few(repeated)):
                self._dropped += int(np.count_nonzero(repeated))
                cleaned = {name: values[~repeated] for name, values in table.items()}
            if cleaned[time].size:
                self._stamp_s, self._end_s = float(stamps_s[-1]), float(cleaned[time][-1])
            yield cleaned

    def _are_rounded(self, repeated: NDArray[np.bool_]) -> bool:
        """Whether the stamps of a block are rounded; the first block with repeated stamps decides for all."""
        if self._rounded_to_s or self._dropped or repeated.size < FEWEST:
            return self._rounded_to_s > 0.0
        return bool(repeated.any() and not _few(repeated) and not repeated[1:].all())

    def _spread(self, stamps_s: Array) -> Array:
        """Times between the stamps, even over the block if this agrees with the stamps."""
        steps_s = np.diff(stamps_s)
        resolution_s = float(steps_s[steps_s > 0.0].min(initial=self._rounded_to_s or np.inf))
        self._rounded_to_s = max(self._rounded_to_s, resolution_s)
        within = _within_runs(stamps_s, resolution_s)
        if within[0] <= self._end_s:  # the run goes on from the block before
            run = int(np.searchsorted(stamps_s, stamps_s[0], side="right"))
            within[:run] = self._end_s + (stamps_s[0] + resolution_s - self._end_s) * np.arange(1, run + 1) / (run + 1)
        if stamps_s.size < FEWEST:
            return within
        count = np.arange(stamps_s.size)
        slope, offset = np.polyfit(count, within, 1)
        even: Array = offset + slope * count
        if even[0] <= self._end_s:
            even = self._end_s + (even[-1] - self._end_s) * (count + 1) / stamps_s.size
        agrees = np.abs(even - within).max() <= EVENLY_WITHIN * resolution_s and even[-1] < stamps_s[-1] + resolution_s
        return even if agrees else within


def _few(repeated: NDArray[np.bool_]) -> bool:
    """Whether a block is long enough, and few of its stamps are repeated."""
    return repeated.size >= FEWEST and bool(np.count_nonzero(repeated) < ROUNDED_SHARE * repeated.size)


def _within_runs(stamps_s: Array, resolution_s: float) -> Array:
    """Each run of equal stamps spread over the resolution."""
    starts = np.flatnonzero(np.diff(stamps_s, prepend=-np.inf) != 0.0)
    lengths = np.diff(starts, append=stamps_s.size)
    position: NDArray[np.int64] = np.arange(stamps_s.size) - np.repeat(starts, lengths)
    spread: Array = stamps_s + resolution_s * position / np.repeat(lengths, lengths)
    return spread
