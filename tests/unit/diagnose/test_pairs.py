"""Two effects at once: what add_pair promise together is what least squares says, and they are found."""

import numpy as np
import pytest
from scipy import signal

from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.selection.moves import add_pair
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.trials import fitted_pairs
from tests.unit.diagnose.residuals import time
from tests.unit.diagnose.test_corners import many_plays
from tests.unit.diagnose.test_search import RATE_HZ, SAMPLES, candidates_of, worked

FINE = 20  # steps of the plant in a sample


def behind(cutoff_Hz, coupled_N_s_per_V):
    """A reading behind a filter, late by what couples from the drive is early; simulated in finer steps."""

    def missing(force_N, u, role):
        if role == "identification":
            return force_N
        rate_Hz = FINE * RATE_HZ
        fine_V = np.interp(time(FINE * SAMPLES, rate_Hz), time(SAMPLES, RATE_HZ), u)
        fine_N = many_plays(fine_V)
        smooth = signal.butter(2, cutoff_Hz, fs=rate_Hz)
        read_N = fine_N[0] + signal.lfilter(*smooth, fine_N - fine_N[0])
        read_N[1:] += coupled_N_s_per_V * np.diff(fine_V) * rate_Hz
        return read_N[::FINE]

    return missing


@pytest.mark.slow
def test_a_filter_and_a_coupling_that_nearly_cancel_are_found_together():
    chain, start = worked(np.random.default_rng(5), behind(12.0, 0.033))
    base = fit(chain, (), start)
    result = Search(chain, base, base, start)
    result = add_pair(candidates_of(result, []))
    assert set(result.names) == {"sensor_filter", "feedthrough"}
    assert [one.accepted.effects for one in result.rounds] == [result.names[:1], result.names]
    values = {name: value for one in result.hypothesis.point.values for name, value in one.items()}
    assert values["coefficient_N_s_per_V"] == pytest.approx(0.033, rel=0.01)
    assert values["cutoff_Hz"] == pytest.approx(12.0, rel=0.01)


def test_a_coupling_behind_a_delay_is_found_where_its_jumps_are():
    def late_and_coupled(force_N, u, role):
        read_N = force_N + 0.05 * RATE_HZ * np.diff(u, prepend=u[0])
        return read_N if role == "identification" else np.concatenate((np.full(4, read_N[0]), read_N[:-4]))

    chain, start = worked(np.random.default_rng(6), late_and_coupled, stairs(np.random.default_rng(7)))
    pairs = fitted_pairs(chain, fit(chain, (), start))
    best = min(pairs, key=lambda one: one.loss)
    assert best.effects == ("transport_delay", "feedthrough")
    assert [term.scope for term in best.terms] == ["since", "already"]
    assert best.loss < 1.05
    assert best.point.values[0]["delay_s"] == pytest.approx(4.0 / RATE_HZ, rel=0.01)
    assert best.point.values[1]["coefficient_N_s_per_V"] == pytest.approx(0.05, rel=0.02)


def stairs(rng):
    """A drive that stands and jumps."""
    return np.repeat(rng.uniform(0.0, 110.0, SAMPLES // 40), 40) * np.minimum(np.arange(SAMPLES) / 400, 1.0)
