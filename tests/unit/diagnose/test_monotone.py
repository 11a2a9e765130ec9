"""Plays that fold are fitted again where they do not: within the bound, and better than what is nearest."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose import diagnosis
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.monotone import SMALLEST_SLOPE, loading_slopes, monotone_fit
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.selection.search_state import Round, Search
from piezod.diagnose.verdict.evidence import finding_of
from piezod.effects import EFFECTS
from tests.unit.diagnose.residuals import mixed_work, noise, played, series, time

SAMPLES, RATE_HZ, NOISE_N = 12_000, 200.0, 0.05
DENSITY = PlayDensity.up_to(119.4)


def chain_over(stack):
    seconds, rng = time(SAMPLES, RATE_HZ), np.random.default_rng(2)
    u = np.clip(mixed_work(seconds) - mixed_work(seconds)[0], 0.0, None)
    made = series(seconds, u, stack(u) + NOISE_N * noise(SAMPLES, 0.0, rng), NOISE_N)
    return Chain([made], DENSITY, ForceLaw(-4.0, 120.0), 100.0)


def folding(u):
    """So much of it in the plays that at the first of them more voltage gives less force."""
    return 0.8 * (u + 1.1 * DENSITY.columns(u, np.empty(0)).sum(axis=1))


def test_what_folds_is_fitted_within_the_bound_and_better_than_its_neighbour():
    chain = chain_over(folding)
    folded = fit(chain, (), empty_point(chain, 0.8, 0.0))
    assert loading_slopes(chain, folded.point.density).min() < 0.0
    found = monotone_fit(chain, folded)
    slopes = loading_slopes(chain, found.point.density)
    assert slopes.min() > SMALLEST_SLOPE - 1e-6
    # One that does not fold either: the same plays, a little less of them, behind the best law for them.
    u, reading_N = chain.series[0].command_V, chain.series[0].reading_N
    less = 0.945 * np.ones(DENSITY.count)
    assert 0.05 < loading_slopes(chain, less).min() < 0.06
    splines, _ = chain.law.columns(u + DENSITY.columns(u, np.empty(0)) @ less)
    left_N = reading_N - splines @ np.linalg.lstsq(splines, reading_N)[0]
    assert folded.loss < found.loss < 0.9 * np.mean(left_N**2) / NOISE_N**2


def test_a_monotone_fit_is_returned_unchanged():
    chain = chain_over(lambda u: 0.7 * u + 0.2 * played(np.concatenate(([0.0], u)), 15.0)[1:])
    found = fit(chain, (), empty_point(chain, 0.8, 0.0))
    assert monotone_fit(chain, found) is found


@pytest.mark.parametrize(("kept", "taken"), [(0.9, True), (0.3, False)])
def test_what_fits_by_plays_that_fold_alone_gives_way_to_what_gains_without(monkeypatch, kept, taken):
    """A lag whose plays fold, as it cannot be had without; a delay in its place keeps a part of what it gained."""
    chain = chain_over(lambda u: 0.7 * np.concatenate((np.zeros(4), u[:-4])))
    base = fit(chain, (), empty_point(chain, 0.7, 0.0))
    starts = {"electrical_lag": {"time_constant_s": 0.02, "swell": 0.0}, "transport_delay": {"delay_s": 0.02}}
    lag, delay = (
        fit(chain, (Term(EFFECTS[name], "already"),), replace(base.point, values=(values,)))
        for name, values in starts.items()
    )
    gained = base.losses - lag.losses
    delay = replace(delay, losses=base.losses - kept * gained)
    folded = replace(lag, point=replace(lag.point, density=lag.point.density - 2.0))
    result = Search(chain, base, folded, base.point, (Round(base, folded, (delay,)),))
    straight = replace(lag, losses=base.losses)
    monkeypatch.setattr(diagnosis, "monotone_fit", lambda _, one: straight if one is folded else one)
    monkeypatch.setattr(diagnosis, "with_each_rival", lambda *_: [delay])
    found = diagnosis.with_monotone_curve(result)
    assert found.hypothesis is (delay if taken else folded)
    if taken:
        finding = finding_of(found, "transport_delay")
        assert [one.name for one in finding.rivals] == ["electrical_lag"]
        assert finding.confidence < 0.6
