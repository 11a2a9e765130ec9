"""The smooth base: its sums are derivatives, it predicts other work to the noise, and nothing it says is unbounded."""

import numpy as np
import pytest

from piezod.estimation.base.reduction import reduced
from piezod.estimation.base.smooth_base import fit_smooth_base
from piezod.estimation.base.thresholds import dead_zone_thresholds, play_thresholds
from piezod.estimation.fit.columns import Samples, Structure
from piezod.estimation.fit.normal_equations import GROUPS, group_of, pieces_of, sums_of
from piezod.excitation import varying_triangles

PEAK_V, RANGE_N, EPS = 120.0, 250.0, 0.01


class Stack:
    """Force of a stack by other formulas than the base's: 300 stop operators of exponential density, a cubic law.

    Source of the stop: Visintin (1994), Differential Models of Hysteresis, Springer, chapter III.
    """

    def __init__(self, share, bend, width_V):
        self.bend = bend
        self.limits_V = PEAK_V * (np.arange(300) + 0.5) / 300
        density = np.exp(-self.limits_V / width_V)
        self.weights = share * density / density.sum()

    def run(self, u):
        stops_V = np.zeros(self.limits_V.size)
        out = np.empty(u.size)
        for k, moved_V in enumerate(np.diff(u, prepend=0.0)):
            stops_V = np.clip(stops_V + moved_V, -self.limits_V, self.limits_V)
            x = (u[k] * (1.0 - self.weights.sum()) + self.weights @ stops_V) / PEAK_V
            out[k] = RANGE_N * (x + self.bend * x**3)
        return out


def fine_tables(u, y):
    low, high = float(y.min()), float(y.max())
    structure = Structure(
        play_thresholds(40, 0.995 * float(np.abs(u).max())),
        dead_zone_thresholds(20, 0.0, high - low),
        low,
        float(np.abs(u).max()),
        float(np.ptp(u)) / (high - low),
    )
    return structure, float(np.ptp(u)) * np.arange(21) / 21


def samples_of(u, y):
    return Samples(u, y, np.ones(u.size, bool))


def force_of(base, u):
    """Simulated force through the sums' own chain."""
    force = np.empty(u.size)
    for piece in pieces_of(base.structure, [samples_of(u, np.arange(float(u.size)))]):
        v = piece.segments @ base.parameters[: base.structure.plays] + base.parameters[base.structure.plays]
        steps = np.clip(v[:, None] - base.zones, 0.0, np.append(np.diff(base.zones), np.inf))
        steps[:, 0] = np.minimum(v, np.append(base.zones, np.inf)[1])
        force[piece.y.astype(int)] = base.structure.origin + steps @ base.parameters[-base.zones.size :]
    return force


def mixed_work(seed, size=4000):
    rng = np.random.default_rng(seed)
    turns = np.concatenate(([0.0], rng.uniform(0.0, PEAK_V, 40)))
    return np.interp(np.linspace(0, turns.size - 1, size), np.arange(turns.size), turns)


@pytest.fixture(scope="module", params=[(0.3, 0.1, 20.0), (0.2, -0.1, 40.0), (0.15, 0.0, 8.0)])
def fitted(request):
    plant = Stack(*request.param)
    u = varying_triangles(PEAK_V, 0.1, 15, 40.0)
    force = plant.run(u)
    noise = 2e-3 * np.ptp(force)
    y = force + np.random.default_rng(3).normal(0.0, noise, u.size)
    samples = samples_of(u, y)
    structure, zones = fine_tables(u, y)
    return plant, samples, noise, fit_smooth_base(structure, zones, [samples], EPS)


def test_the_sums_are_the_derivatives_of_the_squared_error():
    u = varying_triangles(PEAK_V, 0.1, 5, 40.0)
    y = Stack(0.3, 0.1, 20.0).run(u)
    structure, zones = fine_tables(u, y)
    pieces = list(pieces_of(structure, [samples_of(u, y)]))
    rng = np.random.default_rng(0)
    parameters = np.concatenate((rng.uniform(0.8, 1.2, 41), [0.1], rng.uniform(1.5, 2.5, 21)))
    sums = sums_of(pieces, structure, zones, parameters)
    for _ in range(5):
        step = 1e-6 * rng.normal(size=parameters.size)
        ahead, behind = (sums_of(pieces, structure, zones, parameters + way * step).square for way in (1.0, -1.0))
        np.testing.assert_allclose(ahead - behind, -4.0 * sums.side @ step, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("size", [150, 6400, 6433])
def test_pieces_belong_to_the_groups_of_their_samples(size):
    number = np.arange(float(size))
    structure, _ = fine_tables(number, number)
    found = np.empty(size)
    for piece in pieces_of(structure, [samples_of(number, number)]):
        found[piece.y.astype(int)] = piece.group
    np.testing.assert_array_equal(found, group_of(number))


def test_a_band_of_the_input_is_in_one_group_in_every_period():
    u = np.tile(50.0 + 40.0 * np.sin(2 * np.pi * np.arange(400) / 400), 16)
    groups = group_of(u)
    assert (groups.reshape(16, 400) == groups[:400]).all()
    assert set(groups.tolist()) == set(range(GROUPS))
    for level in (12.0, 37.0, 72.0):
        assert np.unique(groups[np.abs(u - level) < 0.5]).size == 1


def test_rows_that_are_means_fit_the_same_line():
    u = varying_triangles(PEAK_V, 0.1, 15, 400.0)
    y = 2.0 * u
    structure, zones = fine_tables(u, y)
    parameters = np.concatenate((np.ones(41), [0.0], np.full(21, 2.5)))
    whole, means = (
        sums_of(pieces_of(structure, [samples_of(u, y)], every), structure, zones, parameters) for every in (1, 10)
    )
    assert means.samples.sum() == pytest.approx(whole.samples.sum(), rel=0.01)
    assert means.rms == pytest.approx(whole.rms, rel=0.01)


def test_other_work_is_predicted_to_the_noise_also_where_the_growing_triangles_reached_last(fitted):
    plant, _, noise, base = fitted
    for seed in range(4):
        u = mixed_work(seed)
        error = force_of(base, u) - plant.run(u)
        assert np.sqrt(np.mean(error**2)) < 0.35 * noise  # 1.06 of the noise in a free run, which adds it in square


def test_what_is_held_out_is_predicted_as_well_as_the_rest_is_fitted(fitted):
    _, samples, noise, base = fitted
    groups = group_of(samples.u)
    errors = np.empty(samples.u.size)
    for group in range(GROUPS):
        other = type(base)(
            base.structure, base.zones, base.without(group), base.sums, base.penalty, base.constraints, base.eps
        )
        mine = groups == group
        errors[mine] = (samples.y - force_of(other, samples.u))[mine]
    assert base.sums.rms == pytest.approx(noise, rel=0.03)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(noise, rel=0.05)


def test_fewer_operators_cost_a_thousandth_of_the_error_and_predict_as_well(fitted):
    plant, samples, noise, base = fitted
    fewer = reduced(base, [samples], float(base.sums.square.sum()))
    assert fewer.structure.plays + fewer.zones.size < base.structure.plays + base.zones.size
    assert fewer.structure.play_thresholds[0] == fewer.zones[0] == 0.0
    assert fewer.sums.rms <= 1.0015 * base.sums.rms
    error = force_of(fewer, u := mixed_work(9)) - plant.run(u)
    assert np.sqrt(np.mean(error**2)) < 0.5 * noise


def test_slopes_that_no_sample_tells_continue_their_neighbours():
    """Only the lower half of the excitation is driven: the tables reach to the whole."""
    u = 0.5 * varying_triangles(PEAK_V, 0.1, 15, 40.0)
    y = Stack(0.3, 0.1, 20.0).run(u)
    structure, _ = fine_tables(2.0 * u, y)
    zones = PEAK_V * np.arange(21) / 21
    base = fit_smooth_base(structure, zones, [samples_of(u, y + np.random.default_rng(1).normal(0, 0.1, u.size))], EPS)
    slopes, law = base.parameters[: structure.plays], base.parameters[-zones.size :]
    told = structure.play_thresholds < 55.0
    assert slopes[~told].max() < 1.5 * slopes[told].max()
    assert law[zones > 55.0].max() < 1.5 * law[zones < 55.0].max()
    assert base.parameters.min() >= -1.0
    assert min(slopes.min(), law.min()) > 0.0
