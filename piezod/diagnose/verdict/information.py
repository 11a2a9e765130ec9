"""Information of recordings about the parameters of a model: the section `information` of its file.

The derivatives of the readings are whitened by the autoregression of the residuals. So samples of coloured noise count
with their effective number. Offsets and unknown pasts are marginalised.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.hypothesis.basis import HATS, SPLINES, ForceLaw
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit, thinned
from piezod.diagnose.hypothesis.left_out import FORM_ERROR, covariance
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.stack_change import NAMES, factors
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.prepare import chain_of
from piezod.estimation.fit.blocks import Blocks, solved, spread
from piezod.estimation.recordings.preparation import prepared
from piezod.estimation.recordings.sources import Source
from piezod.model import Model
from piezod.model.base_figures import BaseFigures, base_figures, figures_of_loops, two_loops
from piezod.model.information import DENSITY, LAW, Information, marginal, packed, rounded

ORDER = 4  # of the autoregression
HALF_95 = 1.96  # half of a 95 % interval [standard errors]
STEP = 1e-4  # of a derivative of the figures, relative to the largest parameter of its kind
FINE_STEPS = 4  # Gauss-Newton steps from the coarse fit to all compared samples
SAME_BASE = 1e-6  # relative difference of two ranges of the base that counts as none


@dataclass(frozen=True)
class _Rows:
    """Named parameters with their information matrix, shape (P, P), in their own units."""

    names: tuple[str, ...]
    estimate: Array
    matrix: Array

    def of(self, names: Sequence[str]) -> Array:
        """Information on some of the parameters if the others are unknown."""
        return marginal(self.matrix, np.array([self.names.index(name) for name in names], dtype=np.int64))


def identified_information(model: Model, sources: Sequence[Source]) -> Information | None:
    """Information about the base; at most 25,000 samples of a recording are compared. None: as in `information_of`.

    Raises
    ------
    RecordingError
        A recording is too short to be diagnosed.
    """
    chain, start = chain_of(prepared(sources, model), model)
    rough = fit(coarse(chain), (), start)
    fitted = fit(chain, (), rough.point, most_steps=FINE_STEPS)
    return information_of(chain, fitted, model, [source.sha256 for source in sources])


def information_of(chain: Chain, fitted: Fitted, model: Model, hashes: Sequence[str]) -> Information | None:
    """Information of the recordings of a hypothesis about its base and its effects.

    The information of the given model is added if it comes from other recordings. Of an effect that has changed since,
    it is omitted. None: the recordings determine no finite figures.

    Parameters
    ----------
    model
        Written model; its section `information` is that of the given model.
    hashes
        SHA-256 of the recording of each series; empty for a series that is no recording.
    """
    low, high = model.input.low, model.input.high
    simulated = [number for number, sha256 in enumerate(hashes) if not sha256]
    errors = _figure_errors(Normal.at(chain, fitted.terms, fitted.point), low, high, simulated)
    figures = base_figures(model.hysteresis, low, high)
    used = [number for number, sha256 in enumerate(hashes) if sha256]
    terms, point = fitted.terms, fitted.point
    changed = any(term.effect.name in NAMES for term in terms)
    if changed:
        used = [number for number in used if chain.series[number].role == "recording"]
        chain, terms, point = _with_changed_stack(chain, fitted, used)
    normal = Normal.at(chain, [replace(term, held=False) for term in terms], point)
    counted = range(len(used)) if changed else used
    colour, noise = _noise_of(normal, counted)
    rows, recordings = _rows_of(normal, _whitened(normal, counted, colour)), tuple(hashes[number] for number in used)
    reach, law_range = chain.density.reach_V, (chain.law.low_V, chain.law.high_V)
    given = model.information
    if given is not None and not changed and not set(given.recordings) & set(recordings):
        same_base = np.allclose((given.reach, *given.law_range), (reach, *law_range), rtol=SAME_BASE)
        rows = _with_given(rows, given, _unchanged_names(given, fitted, same_base=same_base))
        recordings = (*given.recordings, *recordings)
    if not np.isfinite((*vars(figures).values(), *vars(errors).values(), noise, *colour, *rows.matrix.ravel())).all():
        return None
    return Information(
        recordings=recordings,
        driven=(low, high),
        noise=rounded(noise),
        colour=tuple(rounded(value) for value in colour),
        gain=_around(figures.gain, errors.gain),
        loop_width_percent=_around(figures.loop_width_percent, errors.loop_width_percent),
        reach=rounded(reach),
        law_range=(rounded(law_range[0]), rounded(law_range[1])),
        names=rows.names,
        estimate=tuple(rounded(value) for value in rows.estimate),
        root=packed(rows.matrix),
    )


def _around(value: float, error: float) -> tuple[float, float]:
    return rounded(value - HALF_95 * error), rounded(value + HALF_95 * error)


def _figure_errors(normal: Normal, low: float, high: float, simulated: Sequence[int]) -> BaseFigures:
    """Standard errors of the figures of the base, by the jackknife over blocks.

    Simulated series have no noise. They count as if they had the noise that weights them.
    """
    columns, drive = normal.chain.density.columns(two_loops(low, high), np.empty(0)), two_loops(low, high)
    layout, vector = normal.layout, normal.layout.vector(normal.point)

    def figures(at: Array) -> Array:
        point = layout.point(at, normal.point)
        now = factors(normal.terms, point)
        stroke = now.stroke * (drive + now.loops * (columns @ point.density))
        known = figures_of_loops(now.force * normal.chain.law.value(stroke, point.law), low, high)
        return np.array((known.gain, known.loop_width_percent))

    gradient, middle = np.zeros((2, vector.size)), figures(vector)
    factor_places = [
        place
        for place, (term, _) in enumerate(layout.searched, start=layout.effects)
        if normal.terms[term].effect.name in NAMES
    ]
    for places in (range(layout.plays), range(layout.plays, layout.offsets), factor_places):
        size = STEP * max((abs(float(vector[place])) for place in places), default=0.0) or STEP
        for place in places:
            moved = vector.copy()
            moved[place] += size
            gradient[:, place] = (figures(moved) - middle) / size
    moves = normal.left_out_moves() @ gradient.T
    variances = np.diag(spread(moves)).copy()
    edges = np.cumsum([0, *(len(series.blocks) for series in normal.chain.series)])
    follows = solved(normal.total[0], gradient.T).T
    for number in simulated:
        noise = normal.blocks.gram[edges[number] : edges[number + 1]].sum(axis=0)
        variances += np.einsum("ij,jk,ik->i", follows, noise, follows)
    gain, loop_width = np.sqrt(variances)
    return BaseFigures(float(gain), float(loop_width))


def _with_changed_stack(chain: Chain, fitted: Fitted, used: Sequence[int]) -> tuple[Chain, tuple[Term, ...], Point]:
    """Chain of the recordings since the change of the stack, whose base includes it, with terms and point.

    A gain g of the stroke makes the force law steeper: its range is divided by g.
    """
    gain, loops, of_force = factors(fitted.terms, fitted.point)
    law = chain.law
    scaled = ForceLaw(law.low_V / gain, law.high_V / gain, law.kinks_V / gain, law.leaps * gain)
    now = chain.like([chain.series[number] for number in used]).with_base(chain.density, scaled)
    places = [place for place, term in enumerate(fitted.terms) if term.effect.name not in NAMES]
    point = fitted.point.of(used)
    terms = tuple(
        replace(term, series=used.index(term.series)) if term.series in used else term
        for term in (fitted.terms[place] for place in places)
    )
    values = tuple(point.values[place] for place in places)
    offsets_N = point.offsets_N - point.offsets_N[0]
    return (
        now,
        terms,
        replace(point, density=loops * point.density, law=of_force * point.law, values=values, offsets_N=offsets_N),
    )


def _noise_of(normal: Normal, numbers: Sequence[int]) -> tuple[Array, float]:
    """Coefficients of the autoregression of the residuals, shape (ORDER,), and their rms [output unit]."""
    products, samples, square = np.zeros(ORDER + 1), 0.0, 0.0
    for number in numbers:
        residual = normal.weighted[number]
        products += np.array([residual[lag:] @ residual[: residual.size - lag] for lag in range(ORDER + 1)])
        count = float(np.count_nonzero(normal.trust[number]))
        samples += count
        square += float(residual @ residual) * normal.chain.series[number].noise_N ** 2
    if products[0] <= 0.0:
        return np.zeros(ORDER), normal.chain.series[0].noise_N
    lags = np.arange(ORDER)
    normal_equations = products[np.abs(lags[:, None] - lags)]
    return np.linalg.lstsq(normal_equations, products[1:])[0], float(np.sqrt(square / samples))


def _whitened(normal: Normal, numbers: Sequence[int], colour: Array) -> Array:
    """Information matrix of the fitted vector, shape (P, P), from whitened derivatives.

    Blocks pull at the parameters by as much as the noise explains, if the model is right. The information is divided by
    the factor by which they pull more strongly (derived here).
    """
    nothing = np.empty((0, normal.pull.size))  # without a recording there is no information
    recorded = [Blocks.of(nothing, nothing[:, 0], [slice(None)])]
    for number in numbers:
        rows = _innovations(np.sqrt(normal.weights[number])[:, None] * normal.jacobians[number], colour)
        residual = _innovations(normal.weighted[number], colour)
        count = float(np.count_nonzero(normal.trust[number]))
        noise = np.sqrt(max(float(residual @ residual) / max(count, 1.0), 1e-12))
        blocks = thinned(normal.chain.series[number].blocks, normal.chain.rows[number].step)
        recorded.append(Blocks.of(rows / noise, residual / noise, blocks))
    sums = Blocks.all_of(recorded)
    matrix, pulls = sums.total[0], sums.side.T
    matrix = matrix + 1e-12 * np.diag(np.diag(matrix)) + np.diag(normal.stiff)
    seen = int(np.count_nonzero(np.diag(matrix)))
    pulled = float(np.sum(pulls * solved(matrix, pulls)))
    return matrix / max(pulled / max(seen, 1), 1.0)


def _innovations(signal: Array, colour: Array) -> Array:
    """Parts of a signal, shape (N,) or (N, P), that its past does not predict: x_k - sum_j a_j x_(k-j)."""
    white = signal.copy()
    for lag, coefficient in enumerate(colour, start=1):
        white[lag:] -= coefficient * signal[:-lag]
    return white


def _rows_of(normal: Normal, matrix: Array) -> _Rows:
    """Base and lasting effects as named rows; a base with corners has no rows."""
    layout, vector, density = normal.layout, normal.layout.vector(normal.point), normal.chain.density
    named: dict[str, tuple[int, float, float]] = {}  # place, estimate, estimate's change with the vector
    if density.count == HATS and normal.chain.law.count == SPLINES:
        named |= {f"{DENSITY}.{k}": (k, float(vector[k]), 1.0) for k in range(HATS)}
        named |= {f"{LAW}.{k}": (layout.plays + k, float(vector[layout.plays + k]), 1.0) for k in range(SPLINES)}
    for place, (number, parameter) in enumerate(layout.searched, start=layout.effects):
        term, value = normal.terms[number], normal.point.values[number][parameter.name]
        if term.scope != "once":
            change = value if parameter.search.logarithmic else 1.0
            named.setdefault(f"{term.effect.name}.{parameter.name}", (place, value, change))
    places = np.array([place for place, _, _ in named.values()], dtype=np.int64)
    per_unit = 1.0 / np.array([change for _, _, change in named.values()])
    own = marginal(matrix, places) * np.outer(per_unit, per_unit)
    estimate = np.array([value for _, value, _ in named.values()])
    return _Rows(tuple(named), estimate, _weakened(own, normal, places, estimate, per_unit))


def _weakened(own: Array, normal: Normal, places: NDArray[np.int64], estimate: Array, per_unit: Array) -> Array:
    """Information in which the error of an effect's parameter is at least that from left-out blocks."""
    form_errors = np.where(places < normal.layout.effects, 0.0, FORM_ERROR * np.abs(estimate * per_unit))
    left_out = np.diag(covariance(normal.left_out_moves()[:, places], form_errors)) / per_unit**2
    alone = [float(marginal(own, np.array([k], dtype=np.int64))[0, 0]) for k in range(places.size)]
    least = 1.0 / np.maximum(alone, 1e-300)
    factors = np.where(places < normal.layout.effects, 1.0, np.sqrt(np.maximum(left_out / least, 1.0)))
    weakened: Array = own / np.outer(factors, factors)
    return weakened


def _unchanged_names(given: Information, fitted: Fitted, *, same_base: bool) -> list[str]:
    """Rows of the given model that still hold: effects that have not changed, and the base on the same ranges."""
    held = {term.effect.name for term in fitted.terms if term.held}
    base = {DENSITY, LAW} if same_base else set()
    return [name for name in given.names if name.partition(".")[0] in held | base]


def _with_given(rows: _Rows, given: Information, unchanged: Sequence[str]) -> _Rows:
    """Rows with the information of the given model on the parameters that have not changed."""
    names = [name for name in unchanged if name in rows.names]
    known = _Rows(given.names, np.array(given.estimate), given.matrix)
    matrix = rows.matrix.copy()
    if names:
        places = [rows.names.index(name) for name in names]
        matrix[np.ix_(places, places)] += known.of(names)
    return replace(rows, matrix=matrix)
