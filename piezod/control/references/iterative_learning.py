"""Iterative learning: what one repeat of a looped reference shows becomes the correction of the next.

A feedforward controller repeats its error where its reference repeats. Per harmonic of the repeat,

    Y = P U + D
    C = -W D / P

Y is the force and U the planned force with the correction C. P is the response of the bench, D what the model misses.
P is a pure delay at first, the one that fits planned and measured force; then what the force answers to a change of
the correction. D is averaged over the repeats. W is a Wiener gain: near one for what repeats, zero for what does not
(noise, a tone of its own frequency). As everything is computed between repeats, on whole periods, it has no phase.

Source: D. A. Bristow, M. Tharayil and A. G. Alleyne (2006), A survey of iterative learning control, IEEE Control
Systems Magazine 26(3), sections "Q-filter design" and "plant inversion", https://doi.org/10.1109/MCS.2006.1636313.
The response from the repeats themselves: K.-S. Kim and Q. Zou (2013), A Modeling-Free Inversion-Based Iterative
Feedforward Control for Precision Output Tracking of Linear Time-Invariant Systems, IEEE/ASME Transactions on
Mechatronics 18(6).
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array

Spectrum = NDArray[np.complex128]

OBSERVED = 2  # repeats before the first correction: their difference tells what repeats
LEAST_NEW_PART = 0.5
"""Least weight of the newest repeat in the average of what the model misses: a harmonic that changes by no more than
noise. One that changes by more has a weight up to one."""
SIGNIFICANT = 3.0
"""A harmonic whose power is below three times its variance is not learned: noise alone is above it in 5 of 100."""
HIGHEST_PART_OF_RATE = 0.2
"""Highest frequency that is learned, as a part of the tick rate: a tick of delay is 72 degrees there."""
MAINS_Hz = (50.0, 60.0)
MAINS_WITHIN_Hz = 0.5
"""Harmonics this close to the mains or a multiple of it are not learned: a repeat of whole seconds cannot tell hum in
the load cell's cable from an error that repeats, and hum is no force. Grids keep their frequency within 0.2 Hz."""
NEIGHBOURS = 8
GROWS = 1.2
"""A repeat whose error is above 1.2 times that of the repeat before has grown: noise moves it by a few per cent."""
MOST_GROWING = 4
"""Repeats in a row with a growing error, or a force that answers the wrong way, after which learning stops. The first
may be a change of the bench; from the second on, each has half the gain of the one before."""
HARM = 4.0  # a correction does harm where the power of the error within an octave is four times that without it
SMALL = 0.1  # a growth by less than a tenth of the whole power is none
LOWEST_HARMONIC = 4  # octaves begin above this harmonic: below, a step of the load is as large as what a mode does
HARM_WHOLE = 3.0
"""It does harm too where three errors in a row are three times that without it; a step of the load raises two."""
MOST_HARMS = 3
"""Times that a correction may do harm, each with a lower highest frequency than before, until learning stops."""
CAUTIOUS = 0.25
"""Part of the first correction in the upper four octaves: a mode may answer ten times as much as was asked for."""
LONGEST_DELAY_S = 0.2
REMEMBERED = 100
KEPT = 3  # repeats that a correction is computed from: two changes, of which a single event is in one only
LOCAL_PART = 0.05  # the response is smooth over 5 % of a frequency on either side: a mode of 5 % damping is as wide
EXPLAINED = 0.5
"""A change of the force is the answer to a change of the correction where half of its power is coherent with it."""
DOUBT = 30.0
"""The answer outweighs the delay alone where 30 times the power was asked for of what changed unasked before."""
MOST_RATIO, MOST_TURN = 4.0, np.pi / 2
"""Largest ratio and turn of the response against the pure delay below the upper five octaves, where a step of the load
passes for an answer; above, a mode may answer with any ratio and turn."""
TINY = 1e-300


class Learning(Enum):
    """State of the learning."""

    OBSERVING = "observing"
    LEARNING = "learning"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Bounds:
    """Bounds of the correction.

    Parameters
    ----------
    most_N
        Largest correction [N].
    low_N, high_N
        Range of the corrected force [N].
    """

    most_N: float
    low_N: float = -np.inf
    high_N: float = np.inf


class IterativeLearning:
    """Learns the correction of one looped table.

    Parameters
    ----------
    reference_N
        Force to follow, shape (N,) [N].
    planned_N
        Force that is planned for it without a correction, shape (N,) [N].
    rate_Hz
        Tick rate [Hz].

    Attributes
    ----------
    state
        Whether it observes, learns or has stopped.
    repeats
        Number of repeats so far.
    first_N
        Root mean square error of the first repeat [N]; nan before it.
    errors_N
        Those of the last repeats, at most `REMEMBERED` [N].
    """

    def __init__(self, reference_N: Array, planned_N: Array, rate_Hz: float, bounds: Bounds) -> None:
        self._reference_N, self._planned_N, self._bounds = reference_N, planned_N, bounds
        self._rate_Hz = rate_Hz
        frequency_Hz = np.arange(reference_N.size // 2 + 1, dtype=np.float64) * (rate_Hz / reference_N.size)
        self._frequency_Hz, self._omega = frequency_Hz, 2.0 * np.pi * frequency_Hz
        self._not_mains = np.where(_is_mains(frequency_Hz), 0.0, 1.0)
        self._limit_to(HIGHEST_PART_OF_RATE * rate_Hz)
        self._width = np.maximum(2, (LOCAL_PART * np.arange(frequency_Hz.size)).astype(int))
        self._delay: Spectrum | None = None
        self._answer, self._asked = np.zeros(frequency_Hz.size, dtype=complex), np.zeros(frequency_Hz.size)
        self._own = np.zeros(frequency_Hz.size, dtype=complex)  # of a harmonic alone; 0: too little was asked for
        self._unasked: Array | None = None  # power that changes from one repeat to the next by itself
        self._repeats: list[tuple[Spectrum, Spectrum]] = []  # the last: error, correction
        self._gain, self._growing, self._harmed, self._harms = 1.0, 0, 0, 0
        self._plain: list[tuple[float, Array]] = []  # error and its power at the harmonics, without a correction
        self._best_N, self._best = np.inf, np.zeros(reference_N.size)
        self.state = Learning.OBSERVING
        self.repeats, self.first_N = 0, np.nan
        self.errors_N: deque[float] = deque(maxlen=REMEMBERED)

    def add(self, force_N: Array, correction_N: Array, limited: NDArray[np.bool_]) -> Array | None:
        """Add a repeat and return the next correction; None: the present one stays.

        Parameters
        ----------
        force_N
            Measured force of every tick, shape (N,) [N].
        correction_N
            Correction that it was measured with, shape (N,) [N].
        limited
            Ticks whose voltage was changed by a limit, shape (N,); there an error teaches nothing.
        """
        force_N = np.where(limited, self._reference_N, force_N)
        error_N = float(np.sqrt(np.mean((force_N - self._reference_N) ** 2)))
        self.errors_N.append(error_N)
        self.repeats += 1
        self.first_N = error_N if self.repeats == 1 else self.first_N
        if self.state is Learning.STOPPED:
            return None
        if self._delay is None:
            self._delay = self._estimate_delay(np.fft.rfft(self._planned_N + correction_N), np.fft.rfft(force_N))
        spectra = np.fft.rfft(force_N - self._reference_N), np.fft.rfft(correction_N)
        self._repeats = [*self._repeats[1 - KEPT :], spectra]
        if len(self._plain) < OBSERVED:
            self._plain.append((error_N, np.abs(spectra[0]) ** 2))
        if self._keep_best(error_N, correction_N):
            return self._best
        if (harmless_Hz := self._harmless_up_to(error_N, np.abs(spectra[0]) ** 2)) < self._highest_Hz:
            return self._limited_best(harmless_Hz)
        if len(self._repeats) < OBSERVED:
            return None
        self.state = Learning.LEARNING
        wanted_N: Array = np.fft.irfft(self._wanted(), self._reference_N.size)
        return self._bounded(wanted_N)

    def _keep_best(self, error_N: float, correction_N: Array) -> bool:
        """Note the best repeat; True when the error has grown so often that learning stops."""
        before_N = self.errors_N[-2] if len(self.errors_N) > 1 else np.inf
        if error_N < self._best_N:
            self._best_N, self._best = error_N, correction_N.copy()
        grows = error_N > GROWS * before_N or self._answers_wrong_way()
        if grows and self.repeats > OBSERVED:
            self._growing += 1
            self._gain *= 1.0 if self._growing == 1 else 0.5
        elif error_N < before_N:
            self._growing, self._gain = 0, min(1.0, 2.0 * self._gain)
        if self._growing >= MOST_GROWING:
            self.state = Learning.STOPPED
        return self.state is Learning.STOPPED

    def _limit_to(self, highest_Hz: float) -> None:
        """Learn up to a frequency."""
        self._highest_Hz = highest_Hz
        self._band = _roll_off(self._frequency_Hz, highest_Hz)
        self._learned = self._not_mains * self._band

    def _harmless_up_to(self, error_N: float, power: Array) -> float:
        """Frequency below which the correction does not make more than the model left; a mode answers manyfold [Hz]."""
        if self.repeats <= OBSERVED:
            return self._highest_Hz
        plain = np.mean([one for _, one in self._plain], axis=0)
        harmless_Hz, top_Hz = self._highest_Hz, self._highest_Hz
        while top_Hz > LOWEST_HARMONIC * self._rate_Hz / self._reference_N.size:
            octave = (self._frequency_Hz > 0.5 * top_Hz) & (self._frequency_Hz <= top_Hz)
            top_Hz *= 0.5
            if power[octave].sum() > HARM * plain[octave].sum() + SMALL * plain.sum():
                harmless_Hz = top_Hz
        self._harmed = self._harmed + 1 if error_N > HARM_WHOLE * max(one for one, _ in self._plain) else 0
        return 0.5 * harmless_Hz if self._harmed >= KEPT else harmless_Hz

    def _upper(self, octaves: int) -> NDArray[np.bool_]:
        """Mask of the upper octaves of what is learned."""
        low = self._frequency_Hz > self._highest_Hz / 2.0**octaves
        mask: NDArray[np.bool_] = low & (self._frequency_Hz <= self._highest_Hz)
        return mask

    def _limited_best(self, highest_Hz: float) -> Array:
        """The best correction up to a frequency, which is the limit from now on."""
        self._limit_to(highest_Hz)
        self._repeats, self._harmed, self._harms = [], 0, self._harms + 1
        if self._harms >= MOST_HARMS:
            self.state = Learning.STOPPED
        best: Array = np.fft.irfft(self._band * np.fft.rfft(self._best), self._reference_N.size)
        self._best_N, self._best = np.inf, best
        return best

    def _answers_wrong_way(self) -> bool:
        """Whether the force moved against the last change of the correction, by more than what else changed."""
        if len(self._repeats) < OBSERVED or self._delay is None:
            return False
        (before, correction_before), (now, correction) = self._repeats[-2:]
        answer, asked = self._band * (now - before), self._band * self._delay * (correction - correction_before)
        shared = float(np.sum((answer * asked.conj()).real))
        powers = float(np.sum(np.abs(answer) ** 2)) * float(np.sum(np.abs(asked) ** 2))
        return shared < 0.0 and shared**2 > EXPLAINED * powers

    def _estimate_delay(self, planned: Spectrum, measured: Spectrum) -> Spectrum:
        """Response of the pure delay that fits the measured force best."""
        cross = (self._band * self._omega**2 * measured * planned.conj())[self._band > 0.0]
        omega = self._omega[self._band > 0.0]
        longest_s = min(LONGEST_DELAY_S, 0.5 * self._reference_N.size / self._rate_Hz)
        delays_s = np.arange(0.0, longest_s, 0.25 / self._rate_Hz)
        fits = [float(np.sum(cross * np.exp(1j * omega * delay_s)).real) for delay_s in delays_s]
        response: Spectrum = np.exp(-1j * self._omega * delays_s[int(np.argmax(fits))])
        return response

    def _response(self) -> Spectrum:
        """Response of the bench at the harmonics: the delay, corrected by its answer to the last change.

        What repeats does not show in the difference of two repeats, so their ratio is the response alone.
        """
        assert self._delay is not None
        (before, correction_before), (now, correction) = self._repeats[-2:]
        answer, asked = now - before, correction - correction_before
        near = self._width
        if self._unasked is None:
            self._unasked = _local_sum(np.abs(answer - self._delay * asked) ** 2 / 2.0, near).real
        cross, power = _local_sum(answer * asked.conj(), near), _local_sum(np.abs(asked) ** 2, near).real
        whole = _local_sum(np.abs(answer) ** 2, near).real
        doubt = np.maximum(DOUBT * self._unasked, TINY)
        explained = (np.abs(cross) ** 2 > EXPLAINED * power * whole) & (power > doubt)
        self._answer += np.where(explained, answer * asked.conj(), 0.0)
        self._asked += np.where(explained, np.abs(asked) ** 2, 0.0)
        ratio = (_local_sum(self._answer * self._delay.conj(), near) + doubt) / (
            _local_sum(self._asked, near).real + doubt
        )
        size = np.clip(np.abs(ratio), 1.0 / MOST_RATIO, MOST_RATIO)
        turn = np.clip(np.angle(ratio), -MOST_TURN, MOST_TURN)
        own = self._upper(5) & (np.abs(asked) ** 2 > DOUBT * self._unasked / (2.0 * near + 1.0))
        self._own = np.where(own, answer / np.where(own, asked, 1.0), self._own)
        response: Spectrum = np.where(self._own == 0.0, self._delay * size * np.exp(1j * turn), self._own)
        return response

    def _wanted(self) -> Spectrum:
        """Spectrum of the correction that removes what repeats."""
        response = self._response()
        missed = [error - response * correction for error, correction in self._repeats]
        changes = [after - before for before, after in pairwise(missed)]
        # The lesser of two changes: a step of the load changes all harmonics once, and is no noise.
        nearby = np.minimum.reduce([_local_median(np.abs(one) ** 2 / 2.0) / np.log(2.0) for one in changes])
        own = np.minimum.reduce([np.abs(one) ** 2 / 2.0 for one in changes])
        mean = missed[0]
        for one, change in zip(missed[1:], changes, strict=True):
            moves = np.clip(1.0 - SIGNIFICANT * 2.0 * nearby / np.maximum(np.abs(change) ** 2, TINY), 0.0, 1.0)
            part = LEAST_NEW_PART + (1.0 - LEAST_NEW_PART) * moves
            mean = mean + part * (one - mean)
        if len(changes) > 1:
            mean = mean + moves * _trend(*changes)
        variance = np.maximum(own, nearby) * part / (2.0 - part)
        wiener = np.clip(1.0 - SIGNIFICANT * variance / np.maximum(np.abs(mean) ** 2, TINY), 0.0, 1.0)
        present = self._repeats[-1][1]
        is_first = not self._asked.any() and not self._own.any()
        gain = self._gain * np.where(self._upper(4) & is_first, CAUTIOUS, 1.0)
        wanted: Spectrum = present + gain * (-self._learned * wiener * mean / response - present)
        return wanted

    def _bounded(self, correction_N: Array) -> Array:
        bounds = self._bounds
        correction_N = np.clip(correction_N, -bounds.most_N, bounds.most_N)
        low = np.minimum(bounds.low_N - self._planned_N, 0.0)
        high = np.maximum(bounds.high_N - self._planned_N, 0.0)
        return np.clip(correction_N, low, high)


def _roll_off(frequency_Hz: Array, highest_Hz: float) -> Array:
    """Gain one up to two thirds of the highest frequency, then a cosine to zero."""
    part = np.clip((frequency_Hz / highest_Hz - 2.0 / 3.0) * 3.0, 0.0, 1.0)
    rolled: Array = 0.5 * (1.0 + np.cos(np.pi * part))
    return rolled


def _is_mains(frequency_Hz: Array) -> NDArray[np.bool_]:
    """Mask of the mains and its multiples, shape (N,); none in a repeat so short that it has few other harmonics."""
    near = np.zeros(frequency_Hz.size, dtype=bool)
    if frequency_Hz.size < 2 or frequency_Hz[1] > 2.0 * MAINS_WITHIN_Hz + 1e-9:
        return near
    for mains_Hz in MAINS_Hz:
        multiple = np.round(frequency_Hz / mains_Hz)
        near |= (multiple > 0) & (np.abs(frequency_Hz - multiple * mains_Hz) <= MAINS_WITHIN_Hz)
    return near


def _trend(before: Spectrum, last: Spectrum) -> Spectrum:
    """Change that is expected up to the next repeat: as the last one, as far as it went on from the one before."""
    alike = (last * before.conj()).real / np.maximum(np.abs(before) ** 2, TINY)
    trend: Spectrum = np.clip(alike, 0.0, 1.0) * last
    return trend


def _local_sum(values: NDArray[np.complex128] | Array, width: NDArray[np.int64]) -> NDArray[np.complex128]:
    """Sum over `width` neighbours on either side, shape (N,)."""
    total = np.concatenate((np.zeros(1, dtype=complex), np.cumsum(values)))
    k = np.arange(values.size)
    result: NDArray[np.complex128] = total[np.minimum(k + width + 1, values.size)] - total[np.maximum(k - width, 0)]
    return result


def _local_median(power: Array) -> Array:
    """Median over `NEIGHBOURS` on either side, shape (N,)."""
    padded = np.pad(power, NEIGHBOURS, mode="reflect" if power.size > NEIGHBOURS else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
    median: Array = np.median(windows, axis=1)
    return median
