"""Whether an effect predicts data that its parameters were not fitted to: a p-value by a split of the blocks.

Hypotheses with and without the effect are fitted to every other block and compared on the blocks between, then with
both exchanged. A useless effect loses on a block as often as it gains. The values are adjusted over all names of the
catalogue, any of which might have been found (Y. Benjamini and Y. Hochberg (1995), Controlling the False Discovery
Rate, Journal of the Royal Statistical Society B 57(1)). The name itself was chosen on all blocks; how often names are
false is measured on concealed cases (piezod/blind/README.md).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.findings import Finding
from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.selection.acceptance import MOST_OF_A_BLOCK
from piezod.diagnose.selection.search_state import Search
from piezod.effects import EFFECTS

Array = NDArray[np.float64]

STEPS = 6
"""Of each fit, which begins at the parameters of all blocks."""

FLIPS = 20_000
"""Random signs of the gains; the smallest p-value is one in so many."""

FEWEST, NEARLY_ALL = 5, 0.9
"""Blocks that must share nearly all of what is gained. With four, no p-value is below 2^-4 = 6 %."""


def p_value(result: Search, fewer: Fitted, name: str) -> float | None:
    """Probability that a useless effect, or a change of one that makes no difference, gains as much on blocks left out.

    Parameters
    ----------
    result
        Hypothesis with the effect.
    fewer
        The same without it, or as the given model has it.
    name
        Name of the effect.

    Returns
    -------
    float or None
        Above 0, at most 1; None where the effect acts in so few blocks that this test cannot show it.
    """
    chain, found = coarse(result.chain), result.found
    mine = [term for term in (*found.terms, *fewer.terms) if term.effect.name == name]
    gains: list[float] = []
    for parity in (0, 1):
        half = chain.like([replace(one, counts=_every_other(one, parity)) for one in chain.series])
        with_it = fit(half, found.terms, found.point, most_steps=STEPS).point
        without_it = fit(half, fewer.terms, fewer.point, most_steps=STEPS).point
        half.forget()
        for number, series in enumerate(chain.series):
            if any(term.acts_on(number, series) for term in mine):
                before = _losses(chain, number, fewer.terms, without_it)
                after = _losses(chain, number, found.terms, with_it)
                known = (before > 0.0) & (after > 0.0)
                known[parity::2] = False
                gains += np.log(before[known] / after[known]).tolist()
    chain.forget()
    return None if seldom(np.array(gains)) else by_signs(np.array(gains))


def seldom(gains: Array) -> bool:
    """Whether few blocks hold nearly all that is gained.

    Parameters
    ----------
    gains
        Of every block, shape (B,).
    """
    largest = np.sort(np.maximum(gains, 0.0))[::-1]
    return bool(largest[: FEWEST - 1].sum() > NEARLY_ALL * largest.sum())


def with_shares(findings: Sequence[Finding]) -> list[Finding]:
    """Findings with the expected shares of false names.

    Parameters
    ----------
    findings
        Each with its p-value; those without one count as 1 beside the others, and get no share.
    """
    shares = adjusted([1.0 if one.p is None else one.p for one in findings])
    return [replace(one, q=None if one.p is None else share) for one, share in zip(findings, shares, strict=True)]


def adjusted(p_values: Sequence[float]) -> list[float]:
    """Expected share of false names among those with values up to each one's, in the same order.

    Parameters
    ----------
    p_values
        Of the names that were found; those of all other names of the catalogue count as 1.
    """
    order = np.argsort(p_values)
    shares = np.asarray(p_values, dtype=np.float64)[order] * len(EFFECTS) / np.arange(1, len(p_values) + 1)
    least = np.minimum(np.minimum.accumulate(shares[::-1])[::-1], 1.0)
    found = np.empty(len(p_values))
    found[order] = least
    return found.tolist()


def _every_other(series: Series, parity: int) -> NDArray[np.bool_]:
    """Readings that count in every other block."""
    counts = np.zeros(series.counts.size, dtype=bool)
    for block in series.blocks[parity::2]:
        counts[block] = series.counts[block]
    return counts


def _losses(chain: Chain, number: int, terms: Sequence[Term], point: Point) -> Array:
    """Mean square residual of every block of a recording; 0 where nothing counts, shape (blocks,)."""
    series, rows = chain.series[number], chain.rows[number]
    residual, weights = series.residual(rows, chain.compared(number, terms, point))
    step = rows.step
    edges = [slice(-(-one.start // step), -(-one.stop // step)) for one in series.blocks]
    return np.array([residual[one] @ residual[one] / max(float(weights[one] @ weights[one]), 1e-300) for one in edges])


def by_signs(gains: Array) -> float:
    """Probability that the sum of gains is as large with random signs.

    Parameters
    ----------
    gains
        Of every block, shape (B,); a block weighs no more than some of the others.
    """
    if gains.size < 2:
        return 1.0
    most = MOST_OF_A_BLOCK * float(np.median(np.abs(gains)))
    gains = np.clip(gains, -most, most)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, gains.size))
    return float((1 + np.count_nonzero(signs @ gains >= gains.sum() - 1e-12)) / (FLIPS + 1))
