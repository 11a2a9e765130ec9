"""The information of a model file is that of its recordings: intervals, noise and its colour, base and effects."""

import numpy as np
import pytest

import piezod
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.prepare import chain_of, substitute_recording
from piezod.diagnose.verdict.information import information_of
from piezod.model.base_figures import base_figures, figures_of_loops, two_loops
from piezod.model.parameters import Hysteresis, Superposition
from tests.benches.plain_stack import NOISE_N, RATE_HZ, THRESHOLDS_V, WEIGHTS, read, triangles

SHARE = 0.9  # of the coloured noise that lasts to the next sample
DRIVE_V = triangles([100, 40, 80, 60, 100, 30, 90])
TRUTH = base_figures(
    Hysteresis(
        plays=Superposition(thresholds=(0.0, *THRESHOLDS_V.tolist()), weights=(0.6, *WEIGHTS.tolist())),
        dead_zones=Superposition(thresholds=(0.0,), weights=(1.0,)),
    ),
    0.0,
    100.0,
)


def coloured(seed):
    """Noise with a memory, of the same power as the white noise of the bench [N]."""
    rng, noise_N = np.random.default_rng(seed), np.zeros(DRIVE_V.size)
    for k, new in enumerate(rng.normal(0.0, NOISE_N * np.sqrt(1.0 - SHARE**2), DRIVE_V.size)):
        noise_N[k] = SHARE * noise_N[k - 1] + new
    return noise_N


def identified(seed, more_N=0.0):
    time_s = np.arange(DRIVE_V.size) / RATE_HZ
    force_N = read(DRIVE_V, seed) + more_N
    return piezod.identify(piezod.Recording(time_s, {"voltage_V": DRIVE_V, "force_N": force_N})).model


@pytest.fixture(scope="module", params=[False, True], ids=["white", "coloured"])
def models(request):
    """Ten identifications of a bench, with white noise or with white and coloured noise."""
    return [
        identified(seed, coloured(seed + 1000) if request.param else 0.0) for seed in range(100, 110)
    ], request.param


def test_the_intervals_of_gain_and_loop_width_hold_the_truth(models):
    known, _ = models
    for name in ("gain", "loop_width_percent"):
        ends = [getattr(model.information, name) for model in known]
        assert sum(low <= getattr(TRUTH, name) <= high for low, high in ends) >= 8


def test_the_noise_and_its_colour_are_stated(models):
    known, is_coloured = models
    noise_N = np.median([model.information.noise for model in known])
    assert noise_N == pytest.approx(NOISE_N * np.sqrt(2.0) if is_coloured else NOISE_N, rel=0.1)
    lasting = np.median([sum(model.information.colour) for model in known])
    assert lasting > 0.5 if is_coloured else lasting < 0.4


def gain_of(information, estimate):
    """Gain of the base with other values of its parameters."""
    base = [value for name, value in zip(information.names, estimate, strict=True) if name.startswith("density.")]
    law = [value for name, value in zip(information.names, estimate, strict=True) if name.startswith("law.")]
    drive_V = two_loops(*information.driven)
    stroke_V = drive_V + PlayDensity.up_to(information.reach).columns(drive_V, np.empty(0)) @ np.array(base)
    return figures_of_loops(ForceLaw(*information.law_range).value(stroke_V, np.array(law)), *information.driven).gain


def test_the_estimate_is_the_base_and_its_information_predicts_the_scatter(models):
    known, _ = models
    information = known[0].information
    estimate = np.array(information.estimate)
    assert len(estimate) == 26
    assert gain_of(information, estimate) == pytest.approx(TRUTH.gain, rel=1e-3)
    steps = 1e-4 * np.where(np.arange(26) < 14, 0.1, 10.0)
    gradient = [
        (gain_of(information, estimate + step * unit) - gain_of(information, estimate - step * unit)) / (2.0 * step)
        for step, unit in zip(steps, np.eye(26), strict=True)
    ]
    predicted = np.sqrt(gradient @ np.linalg.solve(information.matrix, gradient))
    scatter = np.std([gain_of(model.information, model.information.estimate) for model in known], ddof=1)
    assert 0.5 < predicted / scatter < 2.0


def test_a_model_with_its_information_is_a_small_file(models, tmp_path):
    path = tmp_path / "model.yaml"
    models[0][0].save(path)
    assert path.stat().st_size < 20_000
    assert piezod.Model.load(path) == models[0][0]


def test_a_simulated_series_counts_with_the_noise_that_weights_it(models):
    model = models[0][0].model_copy(update={"information": None})
    chain, start = chain_of([substitute_recording(model)], model)
    fitted = fit(chain, (), start)
    without_noise, with_noise = (information_of(chain, fitted, model, [sha256]) for sha256 in ("0" * 64, ""))
    assert with_noise.recordings == ()
    for name in ("gain", "loop_width_percent"):
        narrow, wide = (np.diff(getattr(one, name))[0] for one in (without_noise, with_noise))
        assert wide > narrow
