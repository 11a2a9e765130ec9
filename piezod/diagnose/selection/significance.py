"""Significance of an effect: a p-value from blocks that were not used for the fit, and the false-discovery rate.

Hypotheses with and without the effect are fitted to every other block and compared on the blocks between, then with
both exchanged. A useless effect loses on a block as often as it gains. The p-values are adjusted over all names of the
catalogue (Y. Benjamini and Y. Hochberg (1995), Controlling the False Discovery Rate, Journal of the Royal Statistical
Society B 57(1)). The name itself was chosen on all blocks. The share of false names is measured on concealed cases
(piezod/blind/README.md).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.findings import Finding
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit, thinned
from piezod.diagnose.hypothesis.left_out import sign_test_p
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.selection.search_state import Search
from piezod.effects import EFFECTS
from piezod.estimation.recordings.series import Series

STEPS = 6  # Gauss-Newton steps of each fit, which begins at the parameters from all blocks
FEWEST, NEARLY_ALL = 5, 0.9
"""Fewest blocks with nearly all of the gain; with four blocks no p-value is below 2^-4 = 6 %."""


def p_value(result: Search, reduced: Fitted, name: str) -> float | None:
    """Probability that a useless effect, or a useless change of an effect, gains as much on left-out blocks.

    None if the effect acts in too few blocks for the test.

    `reduced`: hypothesis without the effect `name`, or with its values in the given model.
    """
    chain, fitted = coarse(result.chain), result.hypothesis
    terms = [term for term in (*fitted.terms, *reduced.terms) if term.effect.name == name]
    gains: list[float] = []
    for parity in (0, 1):
        half = chain.like([replace(s, counts=_every_other(s, parity)) for s in chain.series])
        with_effect = fit(half, fitted.terms, fitted.point, most_steps=STEPS).point
        without = fit(half, reduced.terms, reduced.point, most_steps=STEPS).point
        half.forget()
        for number, series in enumerate(chain.series):
            if any(term.acts_on(number, series) for term in terms):
                before = _losses(chain, number, reduced.terms, without)
                after = _losses(chain, number, fitted.terms, with_effect)
                known = (before > 0.0) & (after > 0.0)
                known[parity::2] = False
                gains += np.log(before[known] / after[known]).tolist()
    chain.forget()
    return None if is_concentrated(np.array(gains)) else sign_test_p(np.array(gains))


def is_concentrated(gains: Array) -> bool:
    """Whether fewer than `FEWEST` blocks hold nearly all of the gains, shape (B,)."""
    largest = np.sort(np.maximum(gains, 0.0))[::-1]
    return bool(largest[: FEWEST - 1].sum() > NEARLY_ALL * largest.sum())


def with_discovery_rates(findings: Sequence[Finding]) -> list[Finding]:
    """Findings with their false-discovery rates; a finding without p-value counts as 1 and gets no rate."""
    rates = discovery_rates([1.0 if finding.p is None else finding.p for finding in findings])
    return [replace(f, q=None if f.p is None else rate) for f, rate in zip(findings, rates, strict=True)]


def discovery_rates(p_values: Sequence[float]) -> list[float]:
    """False-discovery rate at each p-value: expected share of false names among those with at most this p-value.

    All other names of the catalogue count with a p-value of 1.
    """
    order = np.argsort(p_values)
    shares = np.asarray(p_values, dtype=np.float64)[order] * len(EFFECTS) / np.arange(1, len(p_values) + 1)
    least = np.minimum(np.minimum.accumulate(shares[::-1])[::-1], 1.0)
    rates = np.empty(len(p_values))
    rates[order] = least
    return rates.tolist()


def _every_other(series: Series, parity: int) -> NDArray[np.bool_]:
    """Mask of the readings that count in every other block, shape (N,)."""
    counts = np.zeros(series.counts.size, dtype=bool)
    for block in series.blocks[parity::2]:
        counts[block] = series.counts[block]
    return counts


def _losses(chain: Chain, number: int, terms: Sequence[Term], point: Point) -> Array:
    """Mean square residual of every block of a recording, 0 if no reading counts, shape (B,)."""
    series, rows = chain.series[number], chain.rows[number]
    residual, weights = series.residual(rows, chain.compared(number, terms, point))
    blocks = thinned(series.blocks, rows.step)
    return np.array([residual[b] @ residual[b] / max(float(weights[b] @ weights[b]), 1e-300) for b in blocks])
