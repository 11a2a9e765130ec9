"""Linear dynamics from a drive to the reading: a direct gain, lags and modes, fitted to the residual of a model.

The poles start from equation-error models of several orders at several rates, each improved by prefilters. Gauss-Newton
steps then lower the error of the free run, in which the gains are linear. Every fit has the decays of an unknown past,
so a recording may begin amid motion.

K. Steiglitz, L. E. McBride (1965), A technique for the identification of linear systems, IEEE Transactions on Automatic
Control 10(4). G. H. Golub, V. Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares
problems whose variables separate, SIAM Journal on Numerical Analysis 10(2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.model.unnamed_law import Mode, behind_modes

Poles = NDArray[np.complex128]
"""Real poles, and the upper pole of each complex pair, shape (K,) [1/s]."""

MOST_ROWS = 20_000  # of a recording; longer ones are averaged over boxes of samples
BOXES = (1, 4, 16, 64)  # rates of the start, in samples: a model of many samples a period is badly conditioned
LEAST_ROWS = 200  # of an averaged recording
ORDERS = (1, 2, 4, 6, 8, 12, 16)
PREFILTERS = 4  # rounds of Steiglitz and McBride
FASTEST = 0.5  # shortest time constant [samples of the start]; a faster one is a direct gain
LONGEST, LONGEST_RINGING = 0.5, 0.1
"""Longest time constant of a lag, and of a mode, relative to the recording: a mode that rings longer is a tone."""
MOST_DAMPED = 0.999  # damping ratio of a mode; a pair beyond it is two lags
FOLDS, PIECES = 4, 5  # contiguous folds of each recording, and pieces of a fold with an error each
SIMPLER = 0.9  # largest ratio of the squared errors of omitted folds at which more poles are taken
PATIENCE = 2  # larger numbers of poles that predict no better before the search ends: a mode may need two more
STEPS, SMALL, FALL = 20, 1e-5, 1e-4  # Gauss-Newton: steps, relative difference of a pole, least relative fall of a step
RIDGE = 1e-10  # relative to the largest diagonal: nearly equal poles have large opposite gains


@dataclass(frozen=True)
class Driven:
    """Command and residual of a recording.

    Parameters
    ----------
    command, residual
        Shape (N,) [input unit], [output unit].
    counts
        Whether a residual counts, shape (N,).
    dt_s
        Sample period [s].
    noise
        Noise of a residual [output unit].
    """

    command: Array
    residual: Array
    counts: NDArray[np.bool_]
    dt_s: float
    noise: float

    def averaged(self, box: int) -> "Driven":
        """Means over boxes of samples; a box with a missing residual does not count."""
        rows = self.command.size // box
        shape = (rows, box)
        command, residual = (
            values[: rows * box].reshape(shape).mean(axis=1)
            for values in (self.command, np.where(self.counts, self.residual, 0.0))
        )
        counts: NDArray[np.bool_] = np.all(self.counts[: rows * box].reshape(shape), axis=1)
        return Driven(command, residual, counts, box * self.dt_s, self.noise / np.sqrt(box))


@dataclass(frozen=True)
class LinearDynamics:
    """Direct gain, lags and modes.

    Parameters
    ----------
    poles
        Poles [1/s].
    direct
        Gain without memory [output unit per input unit].
    gains
        Complex gain of each pole, shape (K,) [output unit per input unit]; that of a real pole is real.
    errors
        Squared errors of the pieces of omitted folds, by recording, shape (20 * recordings,) [noise variance].
    references
        Squared errors without dynamics, with an offset of each recording.
    with_one_pole
        Squared error of all omitted folds with the best single pole [noise variance]; infinite: none was tried.
    """

    poles: Poles
    direct: float
    gains: NDArray[np.complex128]
    errors: Array
    references: Array
    with_one_pole: float = np.inf

    @property
    def explained(self) -> float:
        """Share of the squared residual that the dynamics predict on omitted folds; below 0: they make it worse."""
        return 1.0 - float(self.errors.sum() / max(self.references.sum(), 1e-300))

    def tables(self, ends: Sequence[float]) -> tuple[list[float], list[list[float]], list[Mode]]:
        """Memories [s] with their rows, and modes, of an unnamed law whose only driver is the command.

        Parameters
        ----------
        ends
            Commands at the nodes [input unit].
        """
        memories, rows, modes = [0.0], [[self.direct * end for end in ends]], []
        for pole, gain in zip(self.poles, self.gains, strict=True):
            if pole.imag == 0.0:
                memories.append(-1.0 / float(pole.real))
                rows.append([float(gain.real) * end for end in ends])
                continue
            natural = float(abs(pole))
            modes.append(
                Mode(
                    frequency_Hz=natural / (2.0 * np.pi),
                    damping_ratio=-float(pole.real) / natural,
                    real=tuple(float(gain.real) * end for end in ends),
                    imaginary=tuple(float(gain.imag) * end for end in ends),
                )
            )
        return memories, rows, modes


def fit_linear_dynamics(recordings: Sequence[Driven], known: Poles | None = None) -> LinearDynamics | None:
    """Fit linear dynamics to the residuals of recordings; None: no order can be tried.

    More poles are taken while they predict omitted folds better.

    Parameters
    ----------
    known
        Poles that are only refined; None: every order is tried.
    """
    longest = max(recording.command.size for recording in recordings)
    rows = [recording.averaged(max(1, -(-longest // MOST_ROWS))) for recording in recordings]
    tried = [_solved(rows, poles) for poles in (_starts(rows) if known is None else [known])]
    if not tried:
        return None
    best: dict[int, LinearDynamics] = {}
    for dynamics in sorted(tried, key=lambda dynamics: -dynamics.explained):
        best.setdefault(dynamics.poles.size, dynamics)
    chosen: LinearDynamics | None = None
    with_one_pole = np.inf
    duration_s = max(recording.command.size * recording.dt_s for recording in recordings)
    for size in sorted(best):  # more poles are refined until they no longer predict better
        poles = _refined(rows, best[size].poles)
        refined = _solved(rows, poles[_fade(poles, duration_s)])
        if size == 1:
            with_one_pole = float(refined.errors.sum())
        if chosen is None or 1.0 - refined.explained < SIMPLER * (1.0 - chosen.explained):
            chosen, worse = refined, 0
            continue
        worse += 1
        if worse == PATIENCE:
            break
    if chosen is None or chosen.explained <= 0.0:
        return None
    return replace(chosen, with_one_pole=with_one_pole)


def dynamics_words(modes: Sequence[tuple[float, float]], lags_s: Sequence[float]) -> str:
    """Enumeration of modes and lags.

    Parameters
    ----------
    modes
        Natural frequency [Hz] and damping ratio [1] of each mode.
    lags_s
        Time constants [s].
    """
    words = [f"a mode at {frequency_Hz:.4g} Hz (damping {ratio:.2g})" for frequency_Hz, ratio in sorted(modes)]
    words += [f"a lag of {lag_s:.3g} s" for lag_s in sorted(lags_s)]
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _starts(recordings: Sequence[Driven]) -> list[Poles]:
    """Poles of equation-error models of each order at each rate, from the longest recording."""
    longest = max(recordings, key=lambda recording: recording.command.size)
    duration_s = longest.command.size * longest.dt_s
    starts = []
    for box in BOXES:
        rows = longest.averaged(box)
        if rows.command.size < LEAST_ROWS:
            break
        command, residual = rows.command - rows.command.mean(), _filled(rows)
        for order in ORDERS:
            if 8 * order > rows.command.size:
                break
            poles = _continuous(_steiglitz_mcbride(command, residual, order), rows.dt_s, duration_s)
            if poles.size:
                starts.append(poles)
    return starts


def _filled(rows: Driven) -> Array:
    """Residual without its mean; missing ones are interpolated."""
    places = np.arange(rows.residual.size)
    filled = np.interp(places, places[rows.counts], rows.residual[rows.counts])
    centred: Array = filled - filled.mean()
    return centred


def _steiglitz_mcbride(command: Array, residual: Array, order: int) -> Array:
    """Denominator of a transfer function of an order, shape (order + 1,)."""
    none: Array = np.eye(1, order + 1)[0]
    denominator = none
    for _ in range(PREFILTERS):
        u, y = _recursive(command, denominator), _recursive(residual, denominator)
        rows = np.array([-_delayed(y, k) for k in range(1, order + 1)] + [_delayed(u, k) for k in range(order + 1)]).T
        gram = rows.T @ rows
        gram[np.diag_indices_from(gram)] += RIDGE * np.diag(gram).max() + 1e-300
        denominator = _stable(np.concatenate(([1.0], np.linalg.solve(gram, rows.T @ y)[:order])))
        if not np.isfinite(denominator).all():
            return none
    return denominator


def _stable(denominator: Array) -> Array:
    """Denominator with the roots outside the unit circle mirrored into it."""
    if not np.isfinite(denominator).all():
        return denominator
    roots = np.roots(denominator)
    outside = np.abs(roots) >= 1.0
    roots[outside] = 0.999 / np.conj(roots[outside])
    mirrored: Array = np.real(np.poly(roots))
    return mirrored


def _delayed(values: Array, k: int) -> Array:
    delayed: Array = np.concatenate((np.zeros(k), values[: values.size - k]))
    return delayed


@numba.njit(cache=True)
def _recursive(values: Array, denominator: Array) -> Array:
    """Values behind 1 / denominator, from rest."""
    behind = np.empty(values.size)
    for k in range(values.size):
        value = values[k]
        for j in range(1, min(denominator.size, k + 1)):
            value -= denominator[j] * behind[k - j]
        behind[k] = value
    return behind


def _continuous(denominator: Array, dt_s: float, duration_s: float) -> Poles:
    """Continuous poles of a sampled denominator; only poles that the samples can show."""
    roots = np.roots(denominator)
    roots = roots[(np.abs(roots) > np.exp(-1.0 / FASTEST)) & (np.abs(roots) < 1.0)]
    roots = roots[(roots.imag > 0.0) | ((roots.imag == 0.0) & (roots.real > 0.0))]
    poles: Poles = np.log(roots.astype(complex)) / dt_s
    return poles[_fade(poles, duration_s)]


def _fade(poles: Poles, duration_s: float) -> NDArray[np.bool_]:
    """Whether each pole fades early enough within a recording to be no tone or drift, shape (K,)."""
    fade: NDArray[np.bool_] = -poles.real * np.where(poles.imag == 0.0, LONGEST, LONGEST_RINGING) * duration_s > 1.0
    return fade


def _columns(rows: Driven, poles: Poles) -> list[Array]:
    """Command behind each pole: one column for a real pole, real and imaginary part for a pair; shape (N, 1 or 2)."""
    keeps = np.exp(poles * rows.dt_s)
    behind = behind_modes(rows.command, keeps)
    return [behind[:, 2 * k : 2 * k + (1 if pole.imag == 0.0 else 2)] for k, pole in enumerate(poles)]


def _past(rows: Driven, poles: Poles) -> Array:
    """Decays of an unknown past, shape (N, K)."""
    decays = np.exp(np.outer(np.arange(rows.command.size) * rows.dt_s, poles))
    return np.hstack([decays.real, decays.imag[:, poles.imag != 0.0]])


def _design(recordings: Sequence[Driven], poles: Poles) -> list[Array]:
    """Weighted columns of each recording: direct gain, poles, then offset and past of each recording."""
    designs = []
    pasts = [np.hstack([np.ones((rows.command.size, 1)), _past(rows, poles)]) for rows in recordings]
    width = pasts[0].shape[1]
    for number, (rows, past) in enumerate(zip(recordings, pasts, strict=True)):
        own = np.hstack([rows.command[:, None], *_columns(rows, poles)])
        design = np.zeros((rows.command.size, own.shape[1] + width * len(recordings)))
        design[:, : own.shape[1]] = own
        design[:, own.shape[1] + number * width : own.shape[1] + (number + 1) * width] = past
        designs.append(design * (rows.counts / rows.noise)[:, None])
    return designs


def _solved(recordings: Sequence[Driven], poles: Poles) -> LinearDynamics:
    """Gains by least squares, and errors of the omitted folds."""
    designs = _design(recordings, poles)
    targets = [np.where(rows.counts, rows.residual / rows.noise, 0.0) for rows in recordings]
    grams, sides, squares, references = [], [], [], []
    for rows, design, target in zip(recordings, designs, targets, strict=True):
        mean = target.sum() / max(int(rows.counts.sum()), 1)
        for part in np.array_split(np.arange(target.size), FOLDS * PIECES):
            grams.append(design[part].T @ design[part])
            sides.append(design[part].T @ target[part])
            squares.append(float(target[part] @ target[part]))
            references.append(float(np.sum((target[part] - mean * rows.counts[part]) ** 2)))
    gram, side = np.sum(grams, axis=0), np.sum(sides, axis=0)
    errors = np.empty(len(grams))
    for fold in range(FOLDS):
        omitted = [k for k in range(len(grams)) if k // PIECES % FOLDS == fold]
        solution = _least_squares(gram - sum(grams[k] for k in omitted), side - sum(sides[k] for k in omitted))
        for first in omitted[::PIECES] if fold == 0 else ():
            # the past is seen in the first fold only, so it is fitted there
            of_recording = range(first, first + PIECES)
            own_gram, own_side = (np.sum([part[k] for k in of_recording], axis=0) for part in (grams, sides))
            solution = _with_past(own_gram, own_side, solution, 1 + _width(poles), first // (FOLDS * PIECES))
        for k in omitted:
            errors[k] = squares[k] - 2.0 * solution @ sides[k] + solution @ grams[k] @ solution
    solution = _least_squares(gram, side)
    gains, place = [], 1
    for pole in poles:
        real = pole.imag == 0.0
        gains.append(complex(solution[place], 0.0 if real else -solution[place + 1]))
        place += 1 if real else 2
    return LinearDynamics(poles, float(solution[0]), np.array(gains), np.maximum(errors, 1e-300), np.array(references))


def _least_squares(gram: Array, side: Array) -> Array:
    """Solution of normal equations, shape of the right side, with a ridge on scaled columns."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale) + RIDGE * np.eye(scale.size)
    solved: Array = (np.linalg.solve(scaled, (side.T / scale).T).T / scale).T
    return solved


def _width(poles: Poles) -> int:
    return int(np.sum(np.where(poles.imag == 0.0, 1, 2)))


def _with_past(gram: Array, side: Array, solution: Array, shared: int, number: int) -> Array:
    """Solution whose offset and past of one recording are refitted with fixed gains; the first `shared` are gains."""
    past = slice(shared + number * shared, shared + (number + 1) * shared)
    refitted = solution.copy()
    refitted[past] = _least_squares(gram[past, past], side[past] - gram[past, :shared] @ solution[:shared])
    return refitted


def _parameters(poles: Poles) -> Array:
    """Logarithms of time constants, and of natural frequencies and damping odds."""
    values = []
    for pole in poles:
        if pole.imag == 0.0:
            values.append(np.log(-pole.real))
            continue
        damping = min(-pole.real / abs(pole), MOST_DAMPED)
        values += [np.log(abs(pole)), np.log(damping / (1.0 - damping))]
    return np.array(values)


def _poles(parameters: Array, like: Poles) -> Poles:
    """Poles of parameters, real where those of `like` are."""
    poles, place = [], 0
    for pole in like:
        if pole.imag == 0.0:
            poles.append(complex(-np.exp(parameters[place])))
            place += 1
            continue
        damping = min(1.0 / (1.0 + np.exp(-parameters[place + 1])), MOST_DAMPED)
        poles.append(np.exp(parameters[place]) * complex(-damping, np.sqrt(1.0 - damping**2)))
        place += 2
    return np.array(poles)


def _refined(recordings: Sequence[Driven], poles: Poles) -> Poles:
    """Poles after Gauss-Newton steps with damping; the gains follow by least squares."""
    target = np.concatenate([np.where(rows.counts, rows.residual / rows.noise, 0.0) for rows in recordings])

    def fit(at: Array) -> tuple[Array, Array, Array]:
        """Design, solution and error."""
        design = np.vstack(_design(recordings, _poles(at, poles)))
        solution = _least_squares(design.T @ design, design.T @ target)
        return design, solution, target - design @ solution

    at = _parameters(poles)
    design, solution, error = fit(at)
    loss, damping = float(error @ error), 1e-3
    for _ in range(STEPS):
        slopes = np.empty((target.size, at.size))
        for k in range(at.size):
            moved = at.copy()
            moved[k] += SMALL
            slopes[:, k] = (np.vstack(_design(recordings, _poles(moved, poles))) - design) @ solution / SMALL
        slopes -= design @ _least_squares(design.T @ design, design.T @ slopes)
        gram, side = slopes.T @ slopes, slopes.T @ error
        fell = False
        while damping < 1e6:
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-300), side)
            tried = fit(at + np.clip(step, -0.5, 0.5))
            if float(tried[2] @ tried[2]) < loss:
                fell, damping = True, 0.1 * damping
                break
            damping *= 10.0
        if not fell:
            break
        at = at + np.clip(step, -0.5, 0.5)
        design, solution, error = tried
        before, loss = loss, float(error @ error)
        if before - loss < FALL * before:
            break
    return _poles(at, poles)
