"""An unnamed law is fitted where something repeatable is left that no name takes, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.selection.formula import SHAPES, Formula
from piezod.diagnose.selection.unnamed import fit_unnamed
from piezod.estimation.recordings.series import Series
from piezod.model.unnamed_law import LawStep

NOISE_N, DT_S = 0.1, 0.01


def drive(seconds, seed):
    """A walk between levels with ramps of several rates, and sines [V]."""
    draw = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, DT_S)
    corners_s = np.concatenate(([0.0], np.cumsum(draw.uniform(0.3, 2.0, int(seconds)))))
    levels_V = draw.uniform(0.0, 100.0, corners_s.size)
    return time_s, np.interp(time_s, corners_s, levels_V) + 5.0 * np.sin(3.0 * time_s)


def slack(command_V):
    """The force that a stop of finite stiffness adds [N]: an elastic and a yielding part, which no table here has."""
    force_N = np.zeros(command_V.size)
    for k in range(1, command_V.size):
        force_N[k] = np.clip(force_N[k - 1] + 0.05 * (command_V[k] - command_V[k - 1]), -0.6, 0.6)
    return force_N


def curved(command_V):
    """A wavy force law behind a lag of half a second [N]."""
    force_N = 0.8 * np.sin(command_V / 12.0)
    for k in range(1, force_N.size):
        force_N[k] = force_N[k - 1] + (force_N[k] - force_N[k - 1]) * DT_S / 0.5
    return force_N


def recordings(law, *, also_before):
    made, modelled = [], []
    for role, seed in (("identification", 1), ("recording", 2)):
        time_s, command_V = drive(60.0, seed)
        expected_N = 2.0 * command_V
        added_N = law(command_V) if also_before or role == "recording" else 0.0
        noise_N = NOISE_N * np.random.default_rng(seed).normal(size=time_s.size)
        counts = np.ones(time_s.size, dtype=bool)
        made.append(Series(role, role, time_s, command_V, expected_N + added_N + noise_N + 7.0, counts, NOISE_N))
        modelled.append(expected_N)
    return made, modelled


@pytest.mark.parametrize("also_before", [True, False])
@pytest.mark.parametrize("law", [slack, curved])
def test_a_law_predicts_another_drive(law, also_before):
    series, modelled = recordings(law, also_before=also_before)
    fit = fit_unnamed(series, modelled, NOISE_N)
    assert fit.already == also_before
    _, command_V = drive(40.0, 3)
    wanted_N = law(command_V)
    added_N = LawStep(fit.law, DT_S).run(command_V, 2.0 * command_V)
    left_N = float(np.std(wanted_N - added_N))
    assert left_N < 0.5 * np.std(wanted_N)
    assert fit.after < fit.before
    assert fit.after == pytest.approx(np.hypot(NOISE_N, left_N), rel=0.3), "the promise is kept on another drive"
    np.testing.assert_allclose(np.mean(LawStep(fit.law, DT_S).run(series[1].command_V, modelled[1])), 0.0, atol=1e-3)


def tiring(command_V):
    """A force whose gain falls by up to a tenth where much was moved within the last seconds [N]."""
    moved_V, gain = np.abs(np.diff(command_V, prepend=command_V[0])) / DT_S, np.zeros(command_V.size)
    for k in range(1, command_V.size):
        gain[k] = gain[k - 1] + (-min(moved_V[k] / 1000.0, 0.1) - gain[k - 1]) * DT_S / 2.0
    return gain * 2.0 * (command_V - command_V[0])


def test_a_gain_that_depends_on_the_drive_is_found_as_a_gain():
    series, modelled = recordings(tiring, also_before=False)
    fit = fit_unnamed(series, modelled, NOISE_N)
    assert fit.law.gain
    _, command_V = drive(40.0, 3)
    wanted_N, added_N = tiring(command_V), LawStep(fit.law, DT_S).run(command_V, 2.0 * command_V)
    assert np.std(wanted_N - added_N) < 0.3 * np.std(wanted_N)


def saturating(command_V):
    """A drag that saturates with the rate of the command [N]."""
    return 1.5 * np.tanh(np.gradient(command_V, DT_S) / 40.0)


def test_a_law_with_a_short_formula_is_told_with_its_numbers():
    series, modelled = recordings(saturating, also_before=True)
    formula = fit_unnamed(series, modelled, NOISE_N).formula
    text = formula.text("V", "N", gain=False)
    assert text.startswith(f"{formula.factor:.3g} N x ")
    assert "rate / " in text
    rate = np.linspace(-150.0, 150.0, 301)
    told = formula.factor * formula.values(rate if formula.driver == "rate" else 2.0 * rate, np.ones(rate.size))
    assert np.abs(told - 1.5 * np.tanh(rate / 40.0)).max() < 0.2


def test_a_law_of_another_shape_has_no_formula():
    series, modelled = recordings(curved, also_before=False)
    assert fit_unnamed(series, modelled, NOISE_N).formula is None


@pytest.mark.parametrize(
    ("shape", "directed", "memory_s", "gain", "text"),
    [
        (4, True, 0.0, False, "-1.2 N x tanh(way / 3 V) x direction"),
        (1, False, 0.5, True, "-1.2 x (way / 3 V)^2, behind a lag of 0.5 s"),
        (6, False, 0.0, False, "-1.2 N x (way / 3 V) / (1 + |way / 3 V|)"),
    ],
)
def test_a_formula_is_written_with_its_units(shape, directed, memory_s, gain, text):
    assert Formula(SHAPES[shape], "way", 3.0, directed, memory_s, -1.2).text("V", "N", gain=gain) == text


def test_a_command_that_stands_still_far_from_zero_has_no_law():
    series, modelled = recordings(lambda command_V: 0.0 * command_V, also_before=True)
    still = [replace(one, command_V=np.full(one.time_s.size, 1e7)) for one in series]
    assert fit_unnamed(still, [np.full(one.size, 2e7) for one in modelled], NOISE_N) is None


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_slow_drift_are_no_law(seed):
    draw = np.random.default_rng(seed)
    series, modelled = recordings(
        lambda command_V: 0.002 * np.cumsum(draw.normal(size=command_V.size)), also_before=True
    )
    assert fit_unnamed(series, modelled, NOISE_N) is None


def test_a_law_that_closes_a_hundredth_of_the_gap_is_not_worth_a_word():
    draw = np.random.default_rng(0)
    series, modelled = recordings(
        lambda command_V: 0.1 * curved(command_V) + draw.normal(size=command_V.size), also_before=False
    )
    assert fit_unnamed(series, modelled, NOISE_N) is None
