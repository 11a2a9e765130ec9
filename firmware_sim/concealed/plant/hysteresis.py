"""The rate-independent hysteresis of a concealed stack; its operator is drawn for every case.

Kinds:

- `preisach`: a smooth random density of relay widths, by Everett tables;
- `bouc_wen`: smooth stops;
- `plays`: 60 to 100 hard stops at random widths;
- `interpolated`: straight lines between a few measured points of one branch.

A sum of play operators follows each of them to well below the noise. The hysteresis alone therefore counts as no
effect. The effect `noncongruent_minor_loops` replaces a share of the irreversible part by an operator that no sum of
plays can follow. This operator is a Preisach density that depends on the bias, or one smooth stop with a small
exponent.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.preisach_table import Everett, everett_by_bias, everett_by_width, everett_interpolated
from firmware_sim.concealed.plant.stops import Stops

Kind = Literal["preisach", "bouc_wen", "plays", "interpolated"]
LOOP_POINTS = 2000
LEAST_OPENING, MOST_OPENING = 0.08, 0.15  # opening of the major loop [range]


@dataclass(frozen=True)
class Hysteresis:
    """Operator from voltage to free stroke; the stroke is expressed in volts.

    Parameters
    ----------
    operator
        Tabulated Preisach plane, or stops.
    scale
        Factor that brings the operator to `reach_V` on the virgin curve at `reach_V` (1).
    irreversible
        Share of the operator in the stroke, 0 to 1; the rest is proportional to the voltage.
    reach_V
        Largest voltage [V].
    """

    kind: Kind
    operator: Everett | Stops
    scale: float
    irreversible: float
    reach_V: float

    def lagging(self, voltage_V: Array, widening: Array | None = None, *, yields_at_rest: bool = False) -> Array:
        """Irreversible part alone, scaled to end at `reach_V`, shape (n,) [V]; for the parameters see `run`."""
        if isinstance(self.operator, Everett):
            if widening is not None:
                raise ValueError("hysteresis kind is preisach, which has no widths to widen; draw plays or bouc_wen")
            return self.scale * self.operator.run(voltage_V)
        path_V = 0.01 * self.reach_V
        return self.scale * (voltage_V - self.operator.run(voltage_V, widening, path_V, yields_at_rest=yields_at_rest))

    def run(self, voltage_V: Array, *, widening: Array | None = None, other: Array | None = None) -> Array:
        """Free stroke over voltages from the virgin state, shape (n,) [V].

        Parameters
        ----------
        voltage_V
            Input, shape (n,) [V].
        widening
            Factor on every width, shape (n,) (1); None: 1.
        other
            Replacement of the irreversible part, shape (n,) [V]; None: no replacement.
        """
        lagging = self.lagging(voltage_V, widening) if other is None else other
        return (1.0 - self.irreversible) * voltage_V + self.irreversible * lagging


def draw_hysteresis(rng: np.random.Generator, kind: Kind, reach_V: float) -> Hysteresis:
    """Draw an operator of a kind whose major loop opens by 8 to 15 % of the range.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    """
    if kind == "preisach":
        operator: Everett | Stops = everett_by_width(rng, reach_V)
    elif kind == "interpolated":
        operator = everett_interpolated(rng, reach_V)
    elif kind == "plays":
        operator = _hard_stops(rng, reach_V)
    else:
        operator = _smooth_stops(rng, reach_V)
    return calibrated(kind, operator, reach_V, rng.uniform(LEAST_OPENING, MOST_OPENING))


def draw_noncongruent(rng: np.random.Generator, reach_V: float) -> Hysteresis:
    """Draw an operator that no sum of play operators can follow.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    """
    if rng.random() < 0.7:
        return calibrated("preisach", everett_by_bias(rng, reach_V), reach_V, MOST_OPENING)
    stops = Stops(
        np.array([rng.uniform(0.15, 0.45) * reach_V]), np.array([rng.uniform(0.6, 0.9)]), rng.uniform(1.0, 3.0)
    )
    return calibrated("bouc_wen", stops, reach_V, MOST_OPENING)


def calibrated(kind: Kind, operator: Everett | Stops, reach_V: float, opening: float) -> Hysteresis:
    """Scale an operator and choose its share so that the major loop opens by `opening` of the range.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    opening
        Greatest distance of the branches, relative to the range [1].
    """
    cycle = major_cycles(reach_V)
    found = Hysteresis(kind, operator, 1.0, 1.0, reach_V)
    found = replace(found, scale=reach_V / found.lagging(cycle)[LOOP_POINTS - 1])
    lagging = found.lagging(cycle)
    shares = np.linspace(0.02, 0.95, 300)
    openings = [loop_opening(share * lagging + (1.0 - share) * cycle) for share in shares]
    return replace(found, irreversible=float(np.interp(opening, openings, shares)))


def major_cycles(reach_V: float) -> Array:
    """Two full triangles from rest, shape (4 LOOP_POINTS,) [V].

    Parameters
    ----------
    reach_V
        Peak of the triangles [V].
    """
    up = np.linspace(0.0, reach_V, LOOP_POINTS)
    return np.concatenate((up, up[::-1], up, up[::-1]))


def loop_opening(stroke_V: Array) -> float:
    """Greatest distance of the branches of the second of `major_cycles`, relative to the range (1).

    Parameters
    ----------
    stroke_V
        Output over `major_cycles`, shape (4 LOOP_POINTS,) [V].
    """
    up, down = stroke_V[2 * LOOP_POINTS : 3 * LOOP_POINTS], stroke_V[3 * LOOP_POINTS :][::-1]
    return float(np.max(np.abs(down - up)) / np.ptp(stroke_V))


def _hard_stops(rng: np.random.Generator, reach_V: float) -> Stops:
    """Draw 60 to 100 hard stops."""
    count = int(rng.integers(60, 101))
    widths = np.sort(rng.uniform(0.002, 1.0, count) ** rng.uniform(1.0, 1.6)) * reach_V
    slope = rng.uniform(0.3, 1.2)
    weights = rng.uniform(0.5, 1.5, count) * np.gradient(widths) / reach_V * np.exp(-slope * widths / reach_V)
    return Stops(widths, rng.uniform(0.75, 0.95) * weights / weights.sum(), 0.0)


def _smooth_stops(rng: np.random.Generator, reach_V: float) -> Stops:
    """Draw 9 to 14 Bouc-Wen stops with a large exponent."""
    count = int(rng.integers(9, 15))
    widths = np.geomspace(rng.uniform(0.01, 0.02), rng.uniform(0.55, 0.8), count)
    widths *= reach_V * np.exp(rng.uniform(-0.08, 0.08, count))
    weights = rng.uniform(0.7, 1.3, count) * widths ** rng.uniform(0.2, 0.6)
    return Stops(widths, rng.uniform(0.75, 0.95) * weights / weights.sum(), rng.uniform(50.0, 150.0))
