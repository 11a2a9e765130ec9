"""PySINDy as a discrepancy model: a sparse differential equation for the residual of the identified model.

r is the measured minus the simulated force, and dr/dt = f(r, u, du/dt, base, further columns). All columns are scaled
to a spread of 1. Libraries are polynomials of first and second degree, with or without sines and cosines of the inputs;
the derivative is smoothed (two windows), or the weak form is fitted (polynomials alone: PySINDy's weak library takes no
composed one). Columns and regression are those of `pysindy.SINDy.fit`; they are separate, since all
thresholds share one set of columns.

Every setting is simulated over every recording, from r = 0 at rest. It is compared on the last fifth, to which it was
not fitted. f is at most quadratic in r, so three evaluations for each sample give its coefficients. An exponential
Euler step integrates it, exactly where f is linear in r and the inputs are held.
"""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import exchange
import numpy as np
import pysindy as ps
from pysindy.utils import AxesArray

SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # least contribution of a term, in parts of the derivative's norm
RIDGE = 1e-6
WINDOWS = (11, 51)  # of the smoothed derivative, samples
HALF_WIDTHS_s = (0.05, 0.5)  # of the weak form's windows
DOMAINS = 400  # of the weak form, in all recordings together
MOST_ROWS = 20_000
RUNS_AWAY = 100.0  # r beyond so many of its spreads has diverged


@dataclass(frozen=True)
class Library:
    """Candidate terms.

    Parameters
    ----------
    name
        Description.
    degree
        Of the polynomials in all columns.
    sines
        Whether sines and cosines of the inputs are among them.
    """

    name: str
    degree: int
    sines: bool

    def terms(self, columns: int) -> ps.feature_library.base.BaseFeatureLibrary:
        """PySINDy's library over so many columns, r the first."""
        polynomials = ps.PolynomialLibrary(degree=self.degree)
        if not self.sines:
            return polynomials
        chosen = [list(range(columns)), list(range(1, columns))]
        return ps.GeneralizedLibrary([polynomials, ps.FourierLibrary(n_frequencies=1)], inputs_per_library=chosen)


LIBRARIES = (
    Library("linear", 1, sines=False),
    Library("quadratic", 2, sines=False),
    Library("linear with sines", 1, sines=True),
    Library("quadratic with sines", 2, sines=True),
)


@dataclass(frozen=True)
class Columns:
    """Columns of one record, scaled: r, then the inputs.

    Parameters
    ----------
    time_s
        Shape (n,) [s].
    values
        Shape (n, 1 + inputs); r is 0 where it was not measured.
    split
        First sample of the part on which settings are compared.
    """

    time_s: np.ndarray
    values: np.ndarray
    split: int

    @property
    def trained(self) -> "Columns":
        """The part for fitting."""
        return Columns(self.time_s[: self.split], self.values[: self.split], self.split)


class Scaling:
    """Scaling of records to columns with a spread of 1; r keeps its zero."""

    def __init__(self, recordings: tuple[exchange.Record, ...]) -> None:
        self.spread_N = float(np.concatenate([record.missing_N for record in recordings]).std()) or 1.0
        self._inputs = ("voltage_V", "base_N", *recordings[0].extra)
        self._scales = {name: exchange.scales(recordings, name) for name in self._inputs}
        rates = np.concatenate([_rate(record) for record in recordings])
        self._rate_scale = float(rates.std()) or 1.0
        self.names = ("r", "u", "base", *recordings[0].extra, "du/dt")

    def columns(self, record: exchange.Record) -> Columns:
        """The scaled columns of a record."""
        inputs = [(record[name] - self._scales[name][0]) / self._scales[name][1] for name in self._inputs]
        r = record.missing_N / self.spread_N if "force_N" in record.columns else np.zeros(record.size)
        values = np.column_stack([r, *inputs, _rate(record) / self._rate_scale])
        return Columns(record["time_s"], values, record.split)


@dataclass(frozen=True)
class LibraryInputs:
    """Inputs of a record, evaluated by the terms of one library.

    Parameters
    ----------
    steps_s
        Shape (n - 1,) [s].
    terms
        Of every sample with r at -1, 0 and 1, shape (n, terms) each.
    """

    steps_s: np.ndarray
    terms: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, library: Library, columns: Columns) -> "LibraryInputs":
        """Evaluate the terms for a record; its r is not used."""
        terms = []
        for r in (-1.0, 0.0, 1.0):
            values = columns.values.copy()
            values[:, 0] = r
            terms.append(np.asarray(library.terms(values.shape[1]).fit_transform(values)))
        return cls(np.diff(columns.time_s), tuple(terms))


def main() -> None:
    """Fit every setting, select the best, and predict."""
    warnings.simplefilter("ignore")
    given = exchange.read()
    scaling = Scaling(given.recordings)
    records = [scaling.columns(record) for record in given.recordings]
    best, best_error, settings = None, math.inf, 0
    for library in LIBRARIES:
        inputs_of_records = [LibraryInputs.of(library, record) for record in records]
        known: dict[bytes, float] = {}
        for setting, coefficients in equations(library, [record.trained for record in records]):
            settings += 1
            key = coefficients.tobytes()
            if key not in known:
                known[key] = _error(coefficients, inputs_of_records, records)
            if known[key] < best_error:
                best, best_error = (library, coefficients, setting), known[key]
    force_N, terms, setting = given.held_out["base_N"], [], "none: all diverge"
    if best is not None:
        library, coefficients, setting = best
        library_inputs = LibraryInputs.of(library, scaling.columns(given.held_out))
        force_N = force_N + scaling.spread_N * free_run(library_inputs, coefficients)
        terms = _kept(library, coefficients, scaling.names)
    exchange.answer(given, force_N, terms, setting, settings)


def equations(library: Library, trained: list[Columns]) -> Iterator[tuple[str, np.ndarray]]:
    """Description of every setting of a library, and its coefficients, shape (terms,)."""
    for derivative, (columns, rate) in _problems(library, trained):
        for share in SHARES:
            threshold = share * float(np.linalg.norm(rate))
            fit = ps.STLSQ(threshold=threshold, alpha=RIDGE, normalize_columns=True).fit(columns, rate)
            yield f"{library.name}, {derivative}, threshold {share:g}", np.ravel(fit.coef_)


def free_run(library_inputs: LibraryInputs, coefficients: np.ndarray) -> np.ndarray:
    """Integrate r from 0, shape (n,); infinite after a divergence.

    Parameters
    ----------
    library_inputs
        The inputs.
    coefficients
        Of the terms, shape (terms,).
    """
    low, middle, high = (terms[:-1] @ coefficients for terms in library_inputs.terms)
    square, slope = 0.5 * (high + low) - middle, 0.5 * (high - low)
    r, run = 0.0, [0.0]
    for c0, c1, c2, step_s in zip(
        middle.tolist(), slope.tolist(), square.tolist(), library_inputs.steps_s.tolist(), strict=True
    ):
        steep = step_s * (c1 + 2.0 * c2 * r)
        grown = math.expm1(min(steep, 30.0)) / steep if abs(steep) > 1e-9 else 1.0
        r += step_s * (c0 + r * (c1 + c2 * r)) * grown
        if not abs(r) < RUNS_AWAY:
            break
        run.append(r)
    return np.array(run + [math.inf] * (library_inputs.steps_s.size + 1 - len(run)))


def _problems(library: Library, trained: list[Columns]) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Methods for the derivative: description, columns of the terms, (rows, terms), rates (rows, 1)."""
    for window in WINDOWS:
        yield f"smoothed over {window} samples", _stacked(_smoothed(library, each, window) for each in trained)
    if not library.sines:
        for half_s in HALF_WIDTHS_s:
            domains = DOMAINS // len(trained)
            yield f"weak over {2 * half_s:g} s", _stacked(_weak(library, each, half_s, domains) for each in trained)


def _stacked(parts: Iterator[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    columns, rates = (np.vstack(part) for part in zip(*parts, strict=True))
    thin = slice(None, None, -(-len(rates) // MOST_ROWS))
    return columns[thin], rates[thin]


def _smoothed(library: Library, record: Columns, window: int) -> tuple[np.ndarray, np.ndarray]:
    differentiation = ps.SmoothedFiniteDifference(smoother_kws={"window_length": window})
    rate = differentiation(record.values[:, :1], record.time_s)
    values = np.column_stack([np.ravel(differentiation.smoothed_x_), record.values[:, 1:]])
    return np.asarray(library.terms(values.shape[1]).fit_transform(values)), np.asarray(rate)


def _weak(library: Library, record: Columns, half_s: float, domains: int) -> tuple[np.ndarray, np.ndarray]:
    np.random.seed(0)  # noqa: NPY002  # PySINDy draws its windows from this
    columns = record.values.shape[1]
    weak = ps.WeakPDELibrary(library.terms(columns), spatiotemporal_grid=record.time_s, H_xt=half_s, K=domains)
    values = AxesArray(record.values, {"ax_time": 0, "ax_coord": 1})
    return np.asarray(weak.fit_transform(values)), np.asarray(weak.convert_u_dot_integral(values[:, :1]))


def _error(coefficients: np.ndarray, inputs_of_records: list[LibraryInputs], records: list[Columns]) -> float:
    """Mean square residual on the last part of the recordings [squared spread of r]; infinite after a divergence."""
    left = [
        (record.values[:, 0] - free_run(library_inputs, coefficients))[record.split :]
        for library_inputs, record in zip(inputs_of_records, records, strict=True)
    ]
    mean = float(np.mean(np.concatenate(left) ** 2))
    return mean if math.isfinite(mean) else math.inf


def _kept(library: Library, coefficients: np.ndarray, names: tuple[str, ...]) -> list[str]:
    """Names of the terms that are not 0; none where only r drives itself, since it begins at 0."""
    terms = library.terms(len(names)).fit(np.zeros((2, len(names)))).get_feature_names(list(names))
    active = [term for term, coefficient in zip(terms, coefficients, strict=True) if coefficient != 0.0]
    return [] if set(active) <= {"r", "r^2"} else active


def _rate(record: exchange.Record) -> np.ndarray:
    return np.gradient(record["voltage_V"], record["time_s"])


if __name__ == "__main__":
    main()
