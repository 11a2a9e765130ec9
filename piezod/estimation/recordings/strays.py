"""Search for stray samples: wild cells, spikes and lost frames, which leave their neighbours and come back at once.

A run of a few samples is stray if it leaps away from the samples on both sides, and these agree with each other. The
other channel must not move. The leap must be far above the noise, the usual steps, and a share of the usual range.
These come from quantiles, which a few samples do not change. Values beyond 1e30 are no numbers in any place. Strays
that share one value outside the range of all others are lost frames: then that value is lost wherever it stands.

The method and its limits are derived here.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Mask
from piezod.estimation.recordings.noise import white_noise
from piezod.recording.recording import Recording
from piezod.recording.stretches import BLOCK, stretches_of

LARGEST = 1e30  # magnitude beyond which a value is infinite, or stands for a missing sample: 9.97e36, 3.4e38
LONGEST = 4  # longest run of strays [samples]; a longer one may be a pulse or a frozen reading
NOISES, STEPS, RANGES = 20.0, 4.0, 0.01
"""Least leap: in standard deviations of the noise, in usual steps, and as share of the usual range. 123 recordings of
emulated and real benches have the same strays by 0.05, 0.02, 0.01 and 0.005 of the range."""

TYPICAL_STEP = 0.9  # quantile of the steps other than 0 that is the usual step
COMES_BACK = 0.25
"""Largest difference of the samples on both sides, and largest answer of the other channel [share of the leap]."""

ANSWERS_WITHIN = 64
"""Samples before a reading, or behind a command, in which the other channel may have caused or answered a leap."""

MOST = 0.05  # share of the samples above which leaps belong to the signal
MOST_LOST = 0.2  # share of the samples above which values far outside the range of all others are no lost frames
FEWEST_LOST, MOST_NAMED = 3, 3  # strays of one value that are lost frames; strays that a note names one by one


@dataclass(frozen=True)
class Strays:
    """Stray samples of one channel: numbers from 0, values that stand there, and times [s], shape (n,) each."""

    channel: str
    rows: NDArray[np.intp]
    values: Array
    times_s: Array

    def notes(self, consequence: str) -> list[str]:
        """One line for each kind of strays; `consequence` for them, such as `left out`."""
        counts = Counter(self.values.tolist())
        lost = [value for value, count in counts.items() if count >= FEWEST_LOST]
        lines = [self._line(self.values == value, f"lost frames at {value:.6g}", consequence) for value in lost]
        spikes = ~np.isin(self.values, lost)
        return [*lines, self._line(spikes, "stray", consequence)] if spikes.any() else lines

    def _line(self, chosen: Mask, kind: str, consequence: str) -> str:
        rows, values, times_s = self.rows[chosen], self.values[chosen], self.times_s[chosen]
        named = ", ".join(
            f"row {row + 1} ({value:.6g} at {at_s:.6g} s)"
            for row, value, at_s in zip(rows[:MOST_NAMED], values, times_s, strict=False)
        )
        count = f"{rows.size} {'sample' if rows.size == 1 else 'samples'}"
        more = f" ... to {times_s[-1]:.6g} s" if rows.size > MOST_NAMED else ""
        return f"{self.channel}: {count}, {kind}: {named}{more}; far from the samples on both sides; {consequence}"


def without_strays(recording: Recording, input_column: str, output_column: str) -> tuple[Recording, list[str]]:
    """The recording without the stray samples of its two channels, and notes.

    Parameters
    ----------
    recording
        It is not changed; rows stay.
    input_column, output_column
        Command and reading; the reading may be absent. A stray reading becomes nan, a stray command is interpolated.
    """
    u = recording.channel(input_column)
    y = recording.channels.get(output_column)
    stray_u = find_strays(u, y, answers_later=True)
    stray_y = None if y is None else find_strays(y, u, answers_later=False)
    channels, notes = dict(recording.channels), []
    if stray_u.any():
        finite = np.isfinite(u) & ~stray_u
        short = stray_u & ~_longer_than(stray_u, LONGEST)
        channels[input_column] = np.where(stray_u, np.nan, u)
        if finite.any():
            filled = np.interp(recording.time_s[short], recording.time_s[finite], u[finite], left=np.nan, right=np.nan)
            channels[input_column][short] = filled
        notes += _strays(recording, input_column, stray_u).notes("interpolated where they are few in a row")
    if stray_y is not None and y is not None and stray_y.any():
        channels[output_column] = np.where(stray_y, np.nan, y)
        notes += _strays(recording, output_column, stray_y).notes("left out")
    return Recording(recording.time_s, channels, recording.metadata, recording.source) if notes else recording, notes


def find_strays(values: Array, other: Array | None, *, answers_later: bool) -> Mask:
    """Mask of the samples of a channel that are stray, shape (N,).

    Parameters
    ----------
    values, other
        Channel, nan where missing, and the channel that causes or answers its leaps, shape (N,); None: there is none.
    answers_later
        Whether the other channel answers (`values` is a command) or causes (it is a reading).
    """
    strays: Mask = np.abs(values) > LARGEST
    finite = np.flatnonzero(np.isfinite(values) & ~strays)
    if finite.size < 100:
        return strays
    known = values[finite]
    span, least = _typical_range(_without_rails(known))
    if not least > 0.0:
        return strays
    leaps = _leaping_runs(known, least)
    if other is not None and leaps:
        other_span = _typical_range(other[np.isfinite(other) & (np.abs(other) < LARGEST)])[0]
        ratio = span / other_span if other_span > 0.0 else 0.0
        leaps = [run for run in leaps if not _explained(known, other[finite], run, ratio, answers_later=answers_later)]
    if sum(end - first for first, end in leaps) > MOST * finite.size:
        strays[finite] = _at_rails(known, leaps, least)
        return strays
    leaping = np.zeros(finite.size, bool)
    for first, end in leaps:
        leaping[first:end] = True
    return _and_lost(strays, leaping, finite, known)


def _without_rails(known: Array) -> Array:
    """Samples without those at a largest or smallest value that many share, far outside the range of all others."""
    low, high = known.min(), known.max()
    rest = known[(known > low) & (known < high)]
    if rest.size < (1.0 - MOST_LOST) * known.size:
        return known
    margin = RANGES * np.ptp(rest)
    at_rail = (known == low) & (low < rest.min() - margin) | (known == high) & (high > rest.max() + margin)
    return known[~at_rail] if np.count_nonzero(at_rail) > MOST / 2 * known.size else known


def _at_rails(known: Array, leaps: list[tuple[int, int]], least: float) -> Mask:
    """Samples at values that many leaps share, each by more than a least leap outside the range of all others."""
    counts = Counter(value for first, end in leaps for value in known[first:end].tolist())
    shared = [value for value, count in counts.items() if count > MOST / 4 * known.size]
    rest = known[~np.isin(known, shared)]
    if not rest.size:
        return np.zeros(known.size, bool)
    low, high = rest.min() - least, rest.max() + least
    lost: Mask = np.isin(known, [value for value in shared if not low <= value <= high])
    return lost if np.count_nonzero(lost) <= MOST_LOST * known.size else np.zeros(known.size, bool)


def _and_lost(strays: Mask, leaping: Mask, finite: NDArray[np.intp], known: Array) -> Mask:
    """All strays; a value that several share is one wherever it stands, if it lies outside the range of the others."""
    if leaping.any() and not leaping.all():
        low, high = known[~leaping].min(), known[~leaping].max()
        for value, count in Counter(known[leaping].tolist()).items():
            same = known == value
            rest = known[~leaping & ~same]
            if count >= FEWEST_LOST and rest.size:
                low, high = rest.min(), rest.max()
                if not low <= value <= high and same.sum() <= MOST * known.size:
                    leaping |= same
    strays[finite[leaping]] = True
    return strays


def _typical_range(values: Array) -> tuple[float, float]:
    """Typical range, and least leap of a stray; of a long channel from samples at equal distances."""
    every = max(1, values.size // BLOCK)
    low, high = np.quantile(values[::every], [0.01, 0.99]) if values.size else (0.0, 0.0)
    near = values[: 4 * BLOCK]
    steps, bends = np.abs(np.diff(near)), np.abs(np.diff(near, 2))
    moving = steps[steps > 0.0]
    step = float(np.quantile(moving, TYPICAL_STEP)) if moving.size else 0.0
    span = float(high - low)
    return span, max(NOISES * white_noise(bends), STEPS * step, RANGES * span)


def _leaping_runs(values: Array, least: float) -> list[tuple[int, int]]:
    """Runs (first, end) of at most `LONGEST` samples that leap away from both sides by more than a least leap."""
    edges = np.flatnonzero(np.abs(np.diff(values)) > least) + 1
    runs: list[tuple[int, int]] = []
    for place, first in enumerate(edges.tolist()):
        if runs and first <= runs[-1][1]:  # the samples between two strays are none
            continue
        for end in edges[place + 1 : place + 1 + LONGEST].tolist():
            if end - first > LONGEST:
                break
            leap = np.abs(values[first:end] - values[first - 1]).min()
            if leap > least and abs(values[end] - values[first - 1]) < COMES_BACK * leap:
                runs.append((first, end))
                break
    return runs


def _explained(values: Array, other: Array, run: tuple[int, int], ratio: float, *, answers_later: bool) -> bool:
    """Whether the other channel moves as fast, before a reading that leaps or behind a command that does."""
    first, end = run
    size = end - first
    leap = np.abs(values[first:end] - values[first - 1]).min()
    begin, stop = (first - 1, end + ANSWERS_WITHIN) if answers_later else (first - ANSWERS_WITHIN, end + 1)
    near = other[max(begin, 0) : stop]
    with np.errstate(invalid="ignore"):  # infinite cells
        moves = np.abs(near[size:] - near[:-size])
    moves = moves[np.isfinite(moves) & (moves < LARGEST)]
    # one move of the other channel that is wild itself explains nothing: its own search names it
    return bool(moves.size and COMES_BACK * leap < ratio * np.sort(moves)[-min(2, moves.size)])


def _longer_than(mask: Mask, samples: int) -> Mask:
    """Which samples lie in runs longer than this."""
    result = np.zeros(mask.size, bool)
    for first, end in stretches_of(mask):
        result[first:end] = end - first > samples
    return result


def _strays(recording: Recording, name: str, mask: Mask) -> Strays:
    rows = np.flatnonzero(mask)
    return Strays(name, rows, recording.channel(name)[rows], recording.time_s[rows])
