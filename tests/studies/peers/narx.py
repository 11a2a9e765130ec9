"""SysIdentPy's FROLS: a polynomial NARX model with the voltage and the identified model's simulation as inputs.

Structures differ in the output (the force, or the residual of the identified model), lags, degree and number of terms.
Each is simulated over the last fifth of the recordings, from its measured start, and the best one predicts. Recordings
are concatenated; all begin at rest. SysIdentPy's inputs begin one sample back, so they are shifted by one sample: the
present voltage may be used, as `piezod` uses it.

A structure reports no missing term in two cases. For the force: only the present force of the identified model. For the
residual: only its own past, which begins at 0.
"""

import math
import re
import warnings
from dataclasses import dataclass

import exchange
import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares
from sysidentpy.utils.display_results import results

NOTHING = frozenset({"base(k)"})
MOST_ROWS = 20_000  # that a structure is fitted on: the last ones before those that it is judged on


@dataclass(frozen=True)
class Structure:
    """What FROLS may choose from.

    Parameters
    ----------
    target
        `force` or `missing` (what the identified model leaves out).
    lags
        Of output and inputs, samples.
    degree
        Of the polynomial.
    terms
        How many are kept, of those that there are.
    """

    target: str
    lags: tuple[int, ...]
    degree: int
    terms: int

    @property
    def words(self) -> str:
        """In words."""
        return f"{self.target}, lags {'/'.join(map(str, self.lags))}, degree {self.degree}, {self.terms} terms"


STRUCTURES = (
    Structure("force", (1, 2), 1, 1),
    *(
        Structure(target, lags, degree, terms)
        for target in ("force", "missing")
        for lags, degree in (((1, 2), 1), ((1, 2, 5, 10, 20), 1), ((1, 2), 2), ((1, 5, 20), 2))
        for terms in (4, 10)
    ),
)


class Series:
    """Recordings behind each other as SysIdentPy takes them, scaled to a spread of 1.

    Parameters
    ----------
    recordings
        Measured ones; they give the scales.
    """

    def __init__(self, recordings: tuple[exchange.Record, ...]) -> None:
        self._inputs = ("voltage_V", "base_N", *recordings[0].extra)
        self._scales = {name: exchange.scales(recordings, name) for name in self._inputs}
        self._missing_N = float(np.concatenate([record.missing_N for record in recordings]).std()) or 1.0
        self.names = ("u", "base", *recordings[0].extra)

    def inputs(self, record: exchange.Record) -> np.ndarray:
        """One sample early, shape (n, inputs)."""
        scaled = [(record[name] - self._scales[name][0]) / self._scales[name][1] for name in self._inputs]
        values = np.column_stack(scaled)
        return np.vstack([values[1:], values[-1:]])

    def output(self, record: exchange.Record, target: str) -> np.ndarray:
        """What is modelled, shape (n, 1); where no force was measured, that of the identified model."""
        force_N = record.columns.get("force_N", record["base_N"])
        if target == "missing":
            return ((force_N - record["base_N"]) / self._missing_N)[:, None]
        middle, spread = self._scales["base_N"]
        return ((force_N - middle) / spread)[:, None]

    def force_N(self, record: exchange.Record, output: np.ndarray, target: str) -> np.ndarray:
        """The force that an output stands for, shape (n,) [N]."""
        if target == "missing":
            return record["base_N"] + self._missing_N * output
        middle, spread = self._scales["base_N"]
        return middle + spread * output


def main() -> None:
    """Fit every structure, take the best, predict."""
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    given = exchange.read()
    series = Series(given.recordings)
    trained = [_part(record, slice(None, record.split)) for record in given.recordings]
    judged = [_part(record, slice(record.split, None)) for record in given.recordings]
    best, best_error = None, math.inf
    for structure in STRUCTURES:
        model = _fitted(structure, series, trained)
        error = np.concatenate([_free_run(model, structure, series, each) - each["force_N"] for each in judged])
        mean = float(np.mean(error**2))
        if mean < best_error:
            best, best_error = (structure, model), mean
    force_N, terms, setting = given.held_out["base_N"], [], "none: all diverge"
    if best is not None:
        structure, model = best
        force_N, setting = _free_run(model, structure, series, given.held_out), structure.words
        terms = _kept(model, structure, series.names)
    exchange.answer(given, force_N, terms, setting, len(STRUCTURES))


def _fitted(structure: Structure, series: Series, records: list[exchange.Record]) -> FROLS:
    inputs = np.vstack([series.inputs(record) for record in records])[-MOST_ROWS:]
    output = np.vstack([series.output(record, structure.target) for record in records])[-MOST_ROWS:]
    lags = list(structure.lags)
    model = FROLS(
        ylag=lags,
        xlag=[lags] * inputs.shape[1],
        n_terms=structure.terms,
        order_selection=False,
        basis_function=Polynomial(degree=structure.degree),
        estimator=LeastSquares(),
    )
    return model.fit(X=inputs, y=output)


def _free_run(model: FROLS, structure: Structure, series: Series, record: exchange.Record) -> np.ndarray:
    """Force in free run, from the first samples of the record (where measured), shape (n,) [N]."""
    output = model.predict(X=series.inputs(record), y=series.output(record, structure.target))
    return series.force_N(record, np.ravel(output), structure.target)


def _kept(model: FROLS, structure: Structure, names: tuple[str, ...]) -> list[str]:
    rows = results(model.final_model, model.theta, model.err, len(model.final_model))
    terms = [_named(row[0], names, structure.target) for row in rows]
    alone = structure.target == "missing" and all(re.fullmatch(r"(r\(k-\d+\)(\^\d)?)+", term) for term in terms)
    return [] if alone or set(terms) == NOTHING else terms


def _named(term: str, names: tuple[str, ...], target: str) -> str:
    """SysIdentPy's term with names of columns; its inputs are one sample early here."""
    for number, name in enumerate(names, 1):
        for lag in (1, 2, 5, 10, 20):
            term = term.replace(f"x{number}(k-{lag})", f"{name}(k-{lag - 1})" if lag > 1 else f"{name}(k)")
    return term.replace("y(", "r(" if target == "missing" else "force(")


def _part(record: exchange.Record, samples: slice) -> exchange.Record:
    return exchange.Record({name: values[samples] for name, values in record.columns.items()})


if __name__ == "__main__":
    main()
