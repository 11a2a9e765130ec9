"""How recordings are cut into what is fitted and what is held out, and what their memory starts with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.estimation.columns import Samples, Structure
from piezod.estimation.initial_state import clipped_mean_square, settled_from, start_amid, start_at_zero, starts_at_rest
from piezod.estimation.smooth_base import fit_roughly
from piezod.estimation.thresholds import INSIDE, dead_zone_thresholds, play_reach, play_thresholds, widest
from piezod.identify.fit import fit_hysteresis, fit_of_base
from piezod.identify.order import residual
from piezod.identify.suitability import FEWEST_SAMPLES
from piezod.recording import Recording
from piezod.recording.names import unit_of

Array = NDArray[np.float64]

START_SAMPLES, START_ROWS = 8000, 3000
"""Samples that are simulated and rows that are fitted to find how a recording starts: it shows over the first rise."""

LEAST_SWING, PLAYS_FOR_A_WIDE_ONE = 0.25, 4
"""Half a swing below this share of the largest input has a table of its own, and for four of its plays a wider one."""

START_ORDERS = (11, 3)
"""Plays and dead zones of the fit that compares starts."""


@dataclass(frozen=True)
class Stretch:
    """One recording: what is fitted, what is held out, and how it starts.

    Parameters
    ----------
    fitted, held_out
        The same samples; other ones count.
    at_rest
        Whether it starts at zero.
    unsettled
        Samples at the start that may depend on what came before.
    notes
        What was noticed.
    """

    fitted: Samples
    held_out: Samples
    at_rest: bool
    unsettled: int = 0
    notes: tuple[str, ...] = ()

    @property
    def rises_first(self) -> bool:
        """Whether it shows a part of the first rise from the de-energised state, which moves the widest plays too."""
        return self.at_rest or len(self.fitted.path) == 1


def whole(recording: Recording, u: Array, y: Array, column: str, eps: float) -> Stretch:
    """A recording of which every sample is fitted.

    Parameters
    ----------
    recording
        For its name.
    u, y
        Input and output, shape (N,); an output that is not there is nan.
    column
        Of the input.
    eps
        Smallest slope.

    Raises
    ------
    RecordingError
        Too few samples are left.
    """
    counts = np.isfinite(y)
    if counts.sum() < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {counts.sum()} samples with an output, needs at least {FEWEST_SAMPLES}; record longer"
        )
    at_rest, loss = starts_at_rest(u), _loss_of_start(u, y, counts, eps)
    notes = []
    start = (start_at_zero if at_rest else start_amid)(u, unit_of(column), loss)
    if start.path:
        notes.append(f"{recording.source}: the stack was {start.words}; that is what its memory starts with")
    samples = Samples(u, np.nan_to_num(y), counts, None, start.path)
    found = Stretch(samples, samples, at_rest, 0 if at_rest else settled_from(u), tuple(notes))
    if found.rises_first:
        return found
    unknown = f"{recording.source}: does not start at rest; plays wider than half its swing stay unknown"
    return replace(found, notes=(*notes, unknown))


def leading_share(recording: Recording, u: Array, y: Array, column: str, share: float, eps: float) -> Stretch:
    """A recording of which the leading share is fitted and the rest is held out; parameters as for `whole`."""
    counts = np.isfinite(y)
    clock: Array | None = None
    path: tuple[float, ...]
    boundary = int(share * u.size)
    at_rest = starts_at_rest(u)
    notes = []
    if at_rest:
        counted = counts.copy()
        counted[boundary:] = False
        start = start_at_zero(u, unit_of(column), _loss_of_start(u, y, counted, eps))
        path = start.path
        if path:
            notes.append(f"{recording.source}: the stack was {start.words}; that is what its memory starts with")
    else:
        first = settled_from(u)
        counts[:first] = False
        path = (float(u[0]),)
        clock = (recording.time_s - recording.time_s[boundary]) / (recording.time_s[boundary] - recording.time_s[0])
        notes.append(
            f"{recording.source}: does not start at rest; its first "
            f"{recording.time_s[first] - recording.time_s[0]:.3g} s are not used, "
            "and plays wider than half its swing stay unknown"
        )
    inside, outside = counts.copy(), counts.copy()
    inside[boundary:], outside[:boundary] = False, False
    if inside.sum() < FEWEST_SAMPLES or outside.sum() < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {inside.sum()} samples to fit and {outside.sum()} to hold out are too few; "
            "record at least three periods"
        )
    fitted = Samples(u, np.nan_to_num(y), inside, clock, path)
    return Stretch(fitted, replace(fitted, counts=outside), at_rest, 0, tuple(notes))


def _loss_of_start(u: Array, y: Array, counts: NDArray[np.bool_], eps: float) -> Callable[[tuple[float, ...]], float]:
    """Mean square error in the output of a middling structure, as a function of the start path."""
    part = slice(None, None, max(1, u.size // START_SAMPLES))
    u, y, counts = u[part], np.nan_to_num(y[part]), counts[part]
    if not np.ptp(u) > 0.0 or counts.sum() < FEWEST_SAMPLES:
        return lambda path: 0.0 if not path else np.inf
    at_rest = starts_at_rest(u)

    def loss(path: tuple[float, ...]) -> float:
        samples = Samples(u, y, counts, None, path)
        structures = Structures([Stretch(samples, samples, at_rest)])
        if not at_rest:
            base = fit_roughly(*structures.smooth(*START_ORDERS), [samples], eps, max(1, u.size // START_ROWS))
            error = residual(fit_of_base(base).hysteresis.operator(), samples)
            return clipped_mean_square(error[counts], y[counts])
        # a penalty would take the kink at an old peak for roughness
        return fit_hysteresis(structures.of(*START_ORDERS), [samples], eps=eps).statistics.rms ** 2

    return loss


class Structures:
    """Thresholds for any orders, from the range that all recordings cover."""

    def __init__(self, stretches: Sequence[Stretch]) -> None:
        parts = [stretch.fitted for stretch in stretches]
        known = [
            samples.y[one.fitted.counts | one.held_out.counts] for samples, one in zip(parts, stretches, strict=True)
        ]
        reaches = [
            play_reach(samples.u, samples.path, at_rest=one.at_rest)
            for samples, one in zip(parts, stretches, strict=True)
        ]
        self._reach = widest(reaches)
        self._u_max = max(float(np.abs(samples.u).max()) for samples in parts)
        self._low = min(float(y.min()) for y in known)
        self._high = max(float(y.max()) for y in known)
        self._origin = float(known[0][0]) if stretches[0].at_rest else self._low
        self._swing = max(float(np.ptp(samples.u)) for samples in parts)
        self._rise = any(one.rises_first for one in stretches)  # which tells plays up to its peak
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
        if half < LEAST_SWING * end:  # amid the range: as fine a table for what moves again and again
            thresholds = np.append(
                play_thresholds(plays, half), np.linspace(half, end, max(2, plays // PLAYS_FOR_A_WIDE_ONE))
            )
        structure = Structure(
            thresholds,
            dead_zone_thresholds(zones, 0.0, self._high - self._low),
            self._low,
            self._u_max,
            self._swing / (self._high - self._low),
        )
        return structure, (self._u_high - self._u_low) * np.arange(zones + 1) / (zones + 1)
