"""Linear dynamics from a drive to the reading: a direct gain, lags and modes, fitted to the residual of a model.

Gauss-Newton steps move the poles from the starts of `pole_starts.py`, and lower the error of the free run. The gains
follow by least squares. Every fit has the decays of an unknown past, so a recording may begin amid motion.

G. H. Golub, V. Pereyra (1973), The differentiation of pseudo-inverses and nonlinear least squares
problems whose variables separate, SIAM Journal on Numerical Analysis 10(2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.fit.blocks import Blocks, contiguous_folds, solved
from piezod.estimation.fit.pole_starts import Driven, Poles, fade, starting_poles
from piezod.estimation.recordings.series import equal_parts
from piezod.model.unnamed_law import Axis, Driver, Mode, UnnamedLaw, behind_modes

MOST_ROWS = 20_000  # of a recording; longer ones are averaged over boxes of samples
MOST_DAMPED = 0.999  # damping ratio of a mode; a pair beyond it is two lags
PIECES = 20  # pieces of a recording with an error each
SIMPLER = 0.9  # largest ratio of the squared errors of omitted folds at which more poles are taken
PATIENCE = 2  # larger numbers of poles that predict no better before the search ends: a mode may need two more
STEPS, SMALL, FALL = 20, 1e-5, 1e-4  # Gauss-Newton: steps, relative difference of a pole, least relative fall of a step


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

    def as_law(
        self,
        driver: Driver,
        driven: Sequence[Array],
        dt_s: float,
        *,
        tare: float = 0.0,
        since: Literal["identification", "later"] = "later",
    ) -> UnnamedLaw:
        """Unnamed law of one driver.

        Parameters
        ----------
        driven
            Values of the driver, shape (N,) each; their range is that of the law [input unit].
        dt_s
            Sample period [s].
        tare
            Constant that is subtracted [output unit].
        since
            When the law appeared.
        """
        ends = min(float(values.min()) for values in driven), max(float(values.max()) for values in driven)
        memories_s, rows, modes = [0.0], [tuple(self.direct * end - tare for end in ends)], []
        for pole, gain in zip(self.poles, self.gains, strict=True):
            real, imaginary = (tuple(float(part) * end for end in ends) for part in (gain.real, gain.imag))
            if pole.imag == 0.0:
                memories_s.append(-1.0 / float(pole.real))
                rows.append(real)
                continue
            natural, damping_ratio = float(abs(pole)), -float(pole.real) / float(abs(pole))
            frequency_Hz = natural / (2.0 * np.pi)
            modes.append(Mode(frequency_Hz=frequency_Hz, damping_ratio=damping_ratio, real=real, imaginary=imaginary))
        return UnnamedLaw(
            drivers=(Axis(driver=driver, low=ends[0], high=ends[1], nodes=2),),
            dead_band=1e-6 * (ends[1] - ends[0]),
            smoothing_s=dt_s,
            memories_s=tuple(memories_s),
            tables=tuple(rows),
            modes=tuple(modes),
            since=since,
        )


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
    tried = [_solved(rows, poles) for poles in (starting_poles(rows) if known is None else [known])]
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
        refined = _solved(rows, poles[fade(poles, duration_s)])
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
    shared, recorded = 1 + _width(poles), []
    for rows, design in zip(recordings, _design(recordings, poles), strict=True):
        target = np.where(rows.counts, rows.residual / rows.noise, 0.0)
        recorded.append(Blocks.of(design, target, equal_parts(target.size, PIECES)))
    sums = Blocks.all_of(recorded)
    offsets_only = sums.along(np.eye(sums.side.shape[1])[:, shared::shared])
    references = offsets_only.errors(offsets_only.solve())
    folds = contiguous_folds([PIECES] * len(recordings))
    folded = sums.folded(folds)
    without = folded.without()
    # the past is seen in the first fold only, so it is fitted there
    gains_only = np.where(np.arange(without.shape[1]) < shared, without[0], np.nan)
    without[0] = solved(folded.gram[0], folded.side[0], gains_only)
    errors, solution = sums.errors(without[folds]), sums.solve()
    gains, place = [], 1
    for pole in poles:
        real = pole.imag == 0.0
        gains.append(complex(solution[place], 0.0 if real else -solution[place + 1]))
        place += 1 if real else 2
    return LinearDynamics(poles, float(solution[0]), np.array(gains), np.maximum(errors, 1e-300), references)


def _width(poles: Poles) -> int:
    return int(np.sum(np.where(poles.imag == 0.0, 1, 2)))


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
    """Poles of parameters, real where the poles `like` are real."""
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
        solution = solved(design.T @ design, design.T @ target)
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
        slopes -= design @ solved(design.T @ design, design.T @ slopes)
        gram, side = slopes.T @ slopes, slopes.T @ error
        fell = False
        while damping < 1e6:
            step = solved(gram + damping * np.diag(np.diag(gram)), side)
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
