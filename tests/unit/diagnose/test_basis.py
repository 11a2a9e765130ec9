"""The base's columns, against the definition of a play."""

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity

SMOOTH = PlayDensity.up_to(120.0)
RNG = np.random.default_rng(1)
SHARP = SMOOTH.beside(np.sort(RNG.uniform(1.0, 100.0, 11)), RNG.normal(size=(11, 1)))
SOME_V = RNG.uniform(1.0, 100.0, 14)
U_V = 60.0 - 60.0 * np.cos(0.03 * np.arange(900)) + 20.0 * np.sin(0.5 * np.arange(900))


def by_definition(density, u, path, factor, offset_V):
    z, out = np.zeros(density.thresholds_V.size), np.zeros((u.size, density.count))
    for v in path:
        z = np.maximum(v - density.thresholds_V, np.minimum(v + density.thresholds_V, z))
    for k, v in enumerate(u):
        wide = density.thresholds_V * factor[k] + offset_V[k]
        z = np.minimum(np.maximum(z, v - wide), v + wide)
        out[k] = (z - v) @ density.hats
    return out


@pytest.mark.parametrize(
    "density",
    [SMOOTH, SHARP, SHARP.smooth(), SHARP.beside(SOME_V, np.eye(14)), SMOOTH.beside(SOME_V[:1], np.eye(1))],
)
@pytest.mark.parametrize("swing", [0.0, 0.1])
def test_columns_are_the_plays_lags(density, swing):
    factor, offset_V = 1.0 + swing * np.sin(U_V), swing * np.cos(U_V)
    found = density.columns(U_V, np.array([80.0, 3.0]), factor, offset_V)
    np.testing.assert_allclose(found, by_definition(density, U_V, (80.0, 3.0), factor, offset_V), atol=1e-12)
    if not swing:
        np.testing.assert_array_equal(found, density.columns(U_V, np.array([80.0, 3.0])))


def test_corners_come_back_from_what_they_were_made_of():
    thresholds_V, weights = SHARP.corners(np.append(np.zeros(SMOOTH.count), 2.0))
    assert np.all(np.diff(thresholds_V) > 0.0)
    np.testing.assert_allclose(SHARP.smooth().columns(U_V, np.empty(0)), SMOOTH.columns(U_V, np.empty(0)))
    lags = SHARP.columns(U_V, np.empty(0))[:, -1] * 2.0
    alone = SMOOTH.beside(thresholds_V, np.eye(11)).columns(U_V, np.empty(0))[:, SMOOTH.count :]
    np.testing.assert_allclose(alone @ weights, lags, atol=1e-12)


def test_a_kink_adds_its_leap_beyond_its_place():
    law = ForceLaw(-4.0, 120.0)
    bent = law.beside(np.array([30.0, 70.0]), np.array([[2.0], [-0.5]]))
    straight = np.append(law.straight(1.0, 1.5), 3.0)
    v = np.linspace(-20.0, 140.0, 321)
    expected = 1.0 + 1.5 * v + 3.0 * (2.0 * np.maximum(v - 30.0, 0.0) - 0.5 * np.maximum(v - 70.0, 0.0))
    np.testing.assert_allclose(bent.value(v, straight), expected, atol=1e-9)
    values, slopes = bent.columns(v)
    np.testing.assert_allclose(values @ straight, expected, atol=1e-9)
    smooth = (np.abs(v - 30.0) > 1.0) & (np.abs(v - 70.0) > 1.0)
    np.testing.assert_allclose((slopes @ straight)[smooth], np.gradient(expected, v)[smooth], atol=1e-9)
