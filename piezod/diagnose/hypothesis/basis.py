"""The base of every hypothesis: a smooth density of plays in front of a smooth force law.

    v = u + sum_k c_k B_k(u),   B_k = sum_i h_k(i) (z_i - u) dr_i / R,        F = sum_j d_j N_j(v)

z_i are 56 plays, h_k fourteen hat functions over their index, N_j quadratic B-splines. The plays enter by their lag
z_i - u, so v is about as large as u. This fixes the scale between plays and force law. A coarse base would leave errors
that look like friction or like a curved force law.
"""

import functools
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.operators.compiled_cache import forget_outdated_steps
from piezod.operators.play import next_state

PLAYS = 56
HATS = 14
SPLINES = 12
PAIR = 5  # largest number of plays between two hats
FINER_NEAR_ZERO = 2.0  # exponent of the spacing of the thresholds
MARGIN = 0.15  # [voltage range] beyond it the force law is straight


@dataclass(frozen=True)
class PlayDensity:
    """Thresholds of the plays, and hat functions over them.

    Parameters
    ----------
    thresholds_V
        r_i, shape (plays,), above 0, rising [V].
    hats
        Weight of play i in column k, shape (plays, columns) [1]: in two neighbouring hats, or in a further column.
    """

    thresholds_V: Array
    hats: Array

    @classmethod
    def up_to(cls, reach_V: float) -> "PlayDensity":
        """Plays with thresholds up to `reach_V` [V], denser near zero."""
        edges = reach_V * (np.arange(PLAYS + 1) / PLAYS) ** FINER_NEAR_ZERO
        places = np.linspace(0, PLAYS - 1, HATS)
        index = np.arange(PLAYS)[:, None]
        hats = np.clip(1.0 - np.abs(index - places) / (places[1] - places[0]), 0.0, None)
        return cls(0.5 * (edges[1:] + edges[:-1]), hats * (np.diff(edges) / reach_V)[:, None])

    @property
    def reach_V(self) -> float:
        """Argument of `up_to` that made the smooth part [V]."""
        return float(2.0 * self.smooth().thresholds_V[-1] / (1.0 + (1.0 - 1.0 / PLAYS) ** FINER_NEAR_ZERO))

    @property
    def count(self) -> int:
        """Number of columns: of the hats, then further ones."""
        return int(self.hats.shape[1])

    def smooth(self) -> "PlayDensity":
        """Density without further columns."""
        rows = ~np.any(self.hats[:, HATS:] != 0.0, axis=1)
        return PlayDensity(self.thresholds_V[rows], self.hats[rows, :HATS])

    def corners(self, coefficients: Array) -> tuple[Array, Array]:
        """Thresholds [V] and weights [1] of the plays in further columns, each shape (K,)."""
        own = np.any(self.hats[:, HATS:] != 0.0, axis=1)
        return self.thresholds_V[own], self.hats[own, HATS:] @ coefficients[HATS:]

    def beside(self, thresholds_V: Array, parts: Array) -> "PlayDensity":
        """Density with further columns.

        Parameters
        ----------
        thresholds_V
            Thresholds of further plays, shape (K,) [V].
        parts
            Weight of each further play in the further columns, shape (K, C) [1]; each is in one column.
        """
        hats = np.zeros((self.hats.shape[0] + parts.shape[0], self.count + parts.shape[1]))
        hats[: self.hats.shape[0], : self.count] = self.hats
        hats[self.hats.shape[0] :, self.count :] = parts
        all_V = np.concatenate((self.thresholds_V, thresholds_V))
        order = np.argsort(all_V, kind="stable")
        return PlayDensity(all_V[order], hats[order])

    def columns(
        self,
        applied_V: Array,
        path_V: Array,
        factor: Array | None = None,
        offset_V: Array | None = None,
        step: int = 1,
    ) -> Array:
        """B_k at every `step`-th sample of a record, shape (rows, columns) [V].

        Parameters
        ----------
        applied_V
            Voltage at the stack, shape (N,) [V].
        path_V
            Voltages since the de-energised state, before the first sample [V].
        factor, offset_V
            Factor [1] and offset [V] of the thresholds, shape (N,) or None.
        step
            Samples from one row to the next.
        """
        forget_outdated_steps(_columns.stats.cache_path)
        out = np.empty((self.count, -(-applied_V.size // step)))
        none = np.empty(0)
        _columns(
            *self._laid_out,
            np.asarray(path_V, dtype=np.float64),
            np.ascontiguousarray(applied_V),
            none if factor is None else factor,
            none if offset_V is None else offset_V,
            step,
            out,
        )
        return out.T

    @functools.cached_property
    def _laid_out(self) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """Thresholds and both weights of the plays, five between two hats, then the values of further columns.

        Unused places have the weight 0. In a further column the first weight counts. The last array holds the first
        place of each further column, shape (further columns + 1,).
        """
        smooth = ~np.any(self.hats[:, HATS:] != 0.0, axis=1)
        laid = np.zeros((3, PAIR * (HATS - 1)))
        rows = np.flatnonzero(smooth)
        first = np.minimum(np.argmax(self.hats[rows] != 0.0, axis=1), HATS - 2)
        for pair in range(HATS - 1):
            plays = rows[first == pair]
            places = slice(PAIR * pair, PAIR * pair + plays.size)
            laid[:, places] = self.thresholds_V[plays], self.hats[plays, pair], self.hats[plays, pair + 1]
        further, starts = [laid], [laid.shape[1]]
        for column in range(HATS, self.count):
            plays = np.flatnonzero(self.hats[:, column])
            further.append(np.array([self.thresholds_V[plays], self.hats[plays, column], np.zeros(plays.size)]))
            starts.append(starts[-1] + plays.size)
        thresholds_V, near, far = np.hstack(further)
        return thresholds_V, near, far, np.array(starts)

    def weights(self, coefficients: Array) -> Array:
        """Weights of u and of every play, shape (1 + plays,) [1]."""
        plays = self.hats @ coefficients
        return np.concatenate(([1.0 - plays.sum()], plays))


@numba.njit(cache=True, nogil=True)
def _columns(
    r: Array,
    near: Array,
    far: Array,
    starts: NDArray[np.int64],
    path: Array,
    u: Array,
    factor: Array,
    offset: Array,
    step: int,
    out: Array,
) -> None:
    """Columns at every `step`-th sample. Plays of constant width are updated at these and at reversals only."""
    plays = r.size
    z, lag, wide = np.zeros(plays), np.zeros(plays), r.copy()
    for k in range(path.size):
        for i in range(plays):
            z[i] = next_state(z[i], r[i], path[k])
    for k in range(u.size):
        is_row = k % step == 0
        now = u[k]
        if factor.size:
            for i in range(plays):
                wide[i] = r[i] * factor[k] + offset[k]
        elif not is_row and k + 1 < u.size and (now == u[k - 1] or (now - u[k - 1]) * (u[k + 1] - now) > 0.0):
            continue
        for i in range(plays):
            z[i] = next_state(z[i], wide[i], now)
            lag[i] = z[i] - now
        if is_row:
            _gather(lag, near, far, starts, out[:, k // step])


@numba.njit(cache=True, nogil=True, inline="always")
def _gather(lag: Array, near: Array, far: Array, starts: NDArray[np.int64], row: Array) -> None:
    """Columns at one sample; the five plays between two hats are written out: a loop takes thrice as long."""
    before, pairs = 0.0, starts[0] // 5
    for j in range(pairs):
        i = 5 * j
        a, b, c, d, e = lag[i], lag[i + 1], lag[i + 2], lag[i + 3], lag[i + 4]
        row[j] = before + (near[i] * a + near[i + 1] * b) + (near[i + 2] * c + near[i + 3] * d) + near[i + 4] * e
        before = (far[i] * a + far[i + 1] * b) + (far[i + 2] * c + far[i + 3] * d) + far[i + 4] * e
    row[pairs] = before
    for column in range(starts.size - 1):
        total = 0.0
        for i in range(starts[column], starts[column + 1]):
            total += near[i] * lag[i]
        row[pairs + 1 + column] = total


@dataclass(frozen=True)
class ForceLaw:
    """Quadratic B-splines on equal intervals, continued straight outside, with further kinks.

    Parameters
    ----------
    low_V, high_V
        Ends of the intervals [V].
    kinks_V
        Voltages of further changes of slope, shape (K,) [V].
    leaps
        Changes of slope in each further column, shape (K, C) [N/V].
    """

    low_V: float
    high_V: float
    kinks_V: Array = field(default_factory=lambda: np.empty(0))
    leaps: Array = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def count(self) -> int:
        """Number of columns: splines, then further ones."""
        return SPLINES + int(self.leaps.shape[1])

    def smooth(self) -> "ForceLaw":
        """Force law without further columns."""
        return ForceLaw(self.low_V, self.high_V)

    def corners(self, coefficients: Array) -> tuple[Array, Array]:
        """Kinks [V] and their leaps [N/V], each shape (K,)."""
        return self.kinks_V, self.leaps @ coefficients[SPLINES:]

    def beside(self, kinks_V: Array, leaps: Array) -> "ForceLaw":
        """Force law with further kinks, shape (K,) [V], and their changes of slope, shape (K, C) [N/V]."""
        known, columns = self.leaps.shape
        wider = np.zeros((known + leaps.shape[0], columns + leaps.shape[1]))
        wider[:known, :columns], wider[known:, columns:] = self.leaps, leaps
        return ForceLaw(self.low_V, self.high_V, np.append(self.kinks_V, kinks_V), wider)

    def columns(self, v: Array) -> tuple[Array, Array]:
        """N_j(v) and dN_j/dv, each of shape (N, count) [1], [1/V]; of kinks [N], [N/V]."""
        values, slopes = np.empty((v.size, SPLINES)), np.empty((v.size, SPLINES))
        _splines(v, self.low_V, (SPLINES - 2) / (self.high_V - self.low_V), values, slopes)
        if not self.kinks_V.size:
            return values, slopes
        beyond = v[:, None] - self.kinks_V
        more, steeper = np.maximum(beyond, 0.0) @ self.leaps, (beyond > 0.0) @ self.leaps
        return np.hstack((values, more)), np.hstack((slopes, steeper))

    def value(self, v: Array, coefficients: Array) -> Array:
        """sum_j d_j N_j(v), shape (N,) [N]."""
        out = np.empty(v.size)
        _law(v, self.low_V, (SPLINES - 2) / (self.high_V - self.low_V), coefficients[:SPLINES], out)
        for kink_V, leap in zip(self.kinks_V, self.leaps @ coefficients[SPLINES:], strict=True):
            if leap != 0.0:
                out += leap * np.maximum(v - kink_V, 0.0)
        return out

    def straight(self, offset: float, slope: float) -> Array:
        """Coefficients of the law offset + slope v; a spline belongs to the middle of its interval."""
        step = (self.high_V - self.low_V) / (SPLINES - 2)
        middles = self.low_V + step * (np.arange(SPLINES) - 0.5)
        return np.concatenate((offset + slope * middles, np.zeros(self.count - SPLINES)))


@numba.njit(cache=True, nogil=True)
def _splines(v: Array, low: float, per_V: float, values: Array, slopes: Array) -> None:
    count = values.shape[1]
    for k in range(v.size):
        for j in range(count):
            values[k, j] = 0.0
            slopes[k, j] = 0.0
        x = (v[k] - low) * per_V
        inside = min(max(x, 0.0), count - 2.0)
        j = min(int(inside), count - 3)
        t = inside - j
        s0, s1, s2 = t - 1.0, 1.0 - 2.0 * t, t
        beyond = x - inside
        values[k, j] = 0.5 * (1.0 - t) ** 2 + beyond * s0
        values[k, j + 1] = 0.5 + t - t * t + beyond * s1
        values[k, j + 2] = 0.5 * t * t + beyond * s2
        slopes[k, j] = s0 * per_V
        slopes[k, j + 1] = s1 * per_V
        slopes[k, j + 2] = s2 * per_V


@numba.njit(cache=True, nogil=True)
def _law(v: Array, low: float, per_V: float, d: Array, out: Array) -> None:
    for k in range(v.size):
        x = (v[k] - low) * per_V
        inside = min(max(x, 0.0), d.size - 2.0)
        j = min(int(inside), d.size - 3)
        t = inside - j
        beyond = x - inside
        out[k] = (
            (0.5 * (1.0 - t) ** 2 + beyond * (t - 1.0)) * d[j]
            + (0.5 + t - t * t + beyond * (1.0 - 2.0 * t)) * d[j + 1]
            + (0.5 * t * t + beyond * t) * d[j + 2]
        )
