"""Samples of a recording that are fitted and held out, and the initial state of its plays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.estimation.base.smooth_base import fit_roughly
from piezod.estimation.base.thresholds import INSIDE, dead_zone_thresholds, play_reach, play_thresholds, widest
from piezod.estimation.fit.columns import Samples, Structure
from piezod.estimation.recordings.start import (
    Path,
    Start,
    clipped_mean_square,
    loss_of_start,
    mean_square,
    output_after,
    start_amid,
    start_at_zero,
    starts_at_rest,
    wipe_out_sample,
)
from piezod.estimation.recordings.suitability import FEWEST_SAMPLES
from piezod.identify.fit import fit_hysteresis, fit_of_base
from piezod.recording import Recording
from piezod.recording.names import unit_of

START_SAMPLES, START_ROWS = 8000, 3000
"""Samples simulated and rows fitted to estimate the start of a recording. The start affects the first rise only."""

LEAST_SWING, FINE_PLAYS_PER_WIDE_PLAY = 0.25, 4
"""If half the swing is below this share of the largest input, the plays are dense up to half the swing.

Above it there is one play for every four dense ones."""

START_ORDERS = (11, 3)  # plays and dead zones of the fit that compares starts


@dataclass(frozen=True)
class Stretch:
    """One recording with its fitted and held-out samples."""

    fitted: Samples  # fitted, held_out: all samples of the recording; `counts` marks the fitted or held-out ones
    held_out: Samples
    at_rest: bool  # whether the input starts at zero
    uncertain: int = 0  # number of samples at the start that may depend on the time before the recording
    notes: tuple[str, ...] = ()  # lines for the user

    @property
    def rises_first(self) -> bool:
        """Whether it shows a part of the first rise from the de-energised state, which also moves the widest plays."""
        return self.at_rest or len(self.fitted.path) == 1


def unsplit_stretch(recording: Recording, u: Array, y: Array, column: str, eps: float) -> Stretch:
    """A recording in which every sample is fitted.

    Parameters
    ----------
    u, y
        Input and output, shape (N,); a missing output is nan.

    Raises
    ------
    RecordingError
        Fewer than 100 samples have an output.
    """
    counts = np.isfinite(y)
    if counts.sum() < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {counts.sum()} samples with an output, needs at least {FEWEST_SAMPLES}; record longer"
        )
    at_rest, loss = starts_at_rest(u), _loss_of_start(u, y, counts, eps)
    start = (start_at_zero if at_rest else start_amid)(u, unit_of(column), loss)
    notes = _start_notes(recording, start)
    samples = Samples(u, np.nan_to_num(y), counts, None, start.path)
    stretch = Stretch(samples, samples, at_rest, 0 if at_rest else wipe_out_sample(u), tuple(notes))
    if stretch.rises_first:
        return stretch
    unknown = f"{recording.source}: does not start at rest; plays wider than half its swing stay unknown"
    return replace(stretch, notes=(*notes, unknown))


def split_stretch(recording: Recording, u: Array, y: Array, column: str, share: float, eps: float) -> Stretch:
    """A recording whose leading share is fitted; the rest is held out. Parameters as for `unsplit_stretch`."""
    counts = np.isfinite(y)
    clock: Array | None = None
    path: Path
    boundary = int(share * u.size)
    at_rest = starts_at_rest(u)
    if at_rest:
        counted = counts.copy()
        counted[boundary:] = False
        start = start_at_zero(u, unit_of(column), _loss_of_start(u, y, counted, eps))
        path, notes = start.path, _start_notes(recording, start)
    else:
        first = wipe_out_sample(u)
        counts[:first] = False
        path = (float(u[0]),)
        clock = (recording.time_s - recording.time_s[boundary]) / (recording.time_s[boundary] - recording.time_s[0])
        unused_s = recording.time_s[first] - recording.time_s[0]
        unused = f"{recording.source}: does not start at rest; its first {unused_s:.3g} s are not used"
        notes = [f"{unused}, and plays wider than half its swing stay unknown"]
    inside, outside = counts.copy(), counts.copy()
    inside[boundary:], outside[:boundary] = False, False
    if inside.sum() < FEWEST_SAMPLES or outside.sum() < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {inside.sum()} samples to fit and {outside.sum()} to hold out are too few; "
            "record at least three periods"
        )
    fitted = Samples(u, np.nan_to_num(y), inside, clock, path)
    return Stretch(fitted, replace(fitted, counts=outside), at_rest, 0, tuple(notes))


def _start_notes(recording: Recording, start: Start) -> list[str]:
    """Note on a stack that was driven before the recording."""
    note = f"{recording.source}: the stack was {start.words}; that is what its memory starts with"
    return [note] if start.path else []


def _loss_of_start(u: Array, y: Array, counts: NDArray[np.bool_], eps: float) -> Callable[[Path], float]:
    """Output error of a fit with `START_ORDERS`, as a function of the start path."""
    part = slice(None, None, max(1, u.size // START_SAMPLES))
    u, y, counts = u[part], np.nan_to_num(y[part]), counts[part]
    if not np.ptp(u) > 0.0 or counts.sum() < FEWEST_SAMPLES:
        return lambda path: 0.0 if not path else np.inf
    at_rest = starts_at_rest(u)

    def outputs(path: Path) -> Array:
        samples = Samples(u, y, counts, None, path)
        structures = Structures([Stretch(samples, samples, at_rest)])
        if at_rest:  # no smoothness penalty here: it would flatten the kink at an old peak
            fit = fit_hysteresis(structures.of(*START_ORDERS), [samples], eps=eps)
        else:
            every = max(1, u.size // START_ROWS)
            fit = fit_of_base(fit_roughly(*structures.smooth(*START_ORDERS), [samples], eps, every))
        return output_after(fit.hysteresis.operator(), path, u)

    return loss_of_start(outputs, y, counts, mean_square if at_rest else clipped_mean_square)


class Structures:
    """Thresholds for any orders, over the range that the recordings cover."""

    def __init__(self, stretches: Sequence[Stretch]) -> None:
        parts = [stretch.fitted for stretch in stretches]
        known = [stretch.fitted.y[stretch.fitted.counts | stretch.held_out.counts] for stretch in stretches]
        self._reach = widest([play_reach(s.fitted.u, s.fitted.path, at_rest=s.at_rest) for s in stretches])
        self._u_max = max(float(np.abs(samples.u).max()) for samples in parts)
        self._low = min(float(y.min()) for y in known)
        self._high = max(float(y.max()) for y in known)
        self._origin = float(known[0][0]) if stretches[0].at_rest else self._low
        self._swing = max(float(np.ptp(samples.u)) for samples in parts)
        self._rise = any(stretch.rises_first for stretch in stretches)  # determines plays up to its peak
        self._u_low = min(float(samples.u.min()) for samples in parts)
        self._u_high = max(float(samples.u.max()) for samples in parts)

    def of(self, plays: int, zones: int) -> Structure:
        """Thresholds for n plays and m dead zones."""
        return Structure(
            play_thresholds(plays, self._reach.end, beyond=self._reach.beyond),
            dead_zone_thresholds(zones, self._low - self._origin, self._high - self._origin),
            self._origin,
            self._u_max,
            self._swing / (self._high - self._low),
        )

    def smooth(self, plays: int, zones: int) -> tuple[Structure, Array]:
        """Tables of the smooth base: n plays, and m dead zones over all inputs from the lowest on, shape (m + 1,)."""
        half, end = 0.5 * self._swing, INSIDE * (self._u_max if self._rise else 0.5 * self._swing)
        thresholds = play_thresholds(plays, end)
        if half < LEAST_SWING * end:
            thresholds = np.append(
                play_thresholds(plays, half), np.linspace(half, end, max(2, plays // FINE_PLAYS_PER_WIDE_PLAY))
            )
        structure = Structure(
            thresholds,
            dead_zone_thresholds(zones, 0.0, self._high - self._low),
            self._low,
            self._u_max,
            self._swing / (self._high - self._low),
        )
        return structure, (self._u_high - self._u_low) * np.arange(zones + 1) / (zones + 1)
