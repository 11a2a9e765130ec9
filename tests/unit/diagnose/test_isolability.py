"""What recordings can tell: sizes from which effects are seen and separated, and what would separate them."""

import numpy as np
import pytest

import piezod
from piezod.diagnose.experiment.isolability import LARGE, Isolability, isolability, separated_by
from piezod.effects import EFFECTS
from piezod.estimation.recordings.sources import Source
from tests.unit.diagnose.residuals import mixed_work

LATE = ("electrical_lag", "sensor_filter", "transport_delay")
NOISE_N = 0.1


@pytest.fixture(scope="module")
def stack():
    return piezod.Model.load("config/model.yaml")


def source(stack, voltage_V, rate_Hz, role="recording"):
    time_s = np.arange(voltage_V.size) / rate_Hz
    force_N = stack.operator().run(voltage_V) + np.random.default_rng(1).normal(0.0, NOISE_N, voltage_V.size)
    channels = {"voltage_V": voltage_V, "force_N": force_N}
    return Source(piezod.Recording(time_s, channels, {}, role), role, role)


def slow_sine(rate_Hz=100.0):
    return 60.0 * (1.0 - np.cos(2.0 * np.pi * 0.1 * np.arange(0.0, 40.0, 1.0 / rate_Hz)))


def steps_and_triangles(rate_Hz=1000.0):
    return mixed_work(np.arange(0.0, 20.0, 1.0 / rate_Hz))


@pytest.fixture(scope="module")
def slow(stack):
    return isolability(stack, [source(stack, slow_sine(), 100.0)], [])


@pytest.fixture(scope="module")
def rich(stack):
    return isolability(stack, [source(stack, steps_and_triangles(), 1000.0)], [])


def at(found: Isolability, first, second):
    return found.separated_from[found.effects.index(first), found.effects.index(second)]


def test_the_noise_is_that_of_the_recording(rich):
    assert rich.noise == pytest.approx(NOISE_N, rel=0.1)


def test_without_a_temperature_nothing_is_said_of_its_drift(stack):
    recorded = source(stack, slow_sine(), 100.0)
    found = isolability(stack, [recorded], [], only={"thermal_drift"})
    assert (found.effects, found.pairs(), found.groups()) == ((), [], [])


def test_a_slow_sine_does_not_separate_what_makes_late(slow):
    assert any(set(LATE) <= set(group) for group in slow.groups())


def test_richer_work_separates_what_a_slow_sine_does_not(slow, rich):
    assert at(rich, "electrical_lag", "sensor_filter") < 0.5 * at(slow, "electrical_lag", "sensor_filter")
    assert len(rich.pairs()) < len(slow.pairs())


def test_an_effect_is_never_separated_before_it_is_seen(slow, rich):
    for found in (slow, rich):
        for place, seen in enumerate(found.seen_from):
            beside = np.delete(found.separated_from[place], place)
            assert (beside >= seen * (1.0 - 1e-9)).all()


def test_twice_the_work_shows_effects_of_a_size_less_by_the_root_of_two(stack):
    drive = slow_sine()
    once = isolability(stack, [source(stack, drive, 100.0)], [])
    twice = isolability(stack, [source(stack, np.concatenate((drive, drive)), 100.0)], [])
    ratios = [
        twice.seen_from[twice.effects.index(name)] / once.seen_from[once.effects.index(name)]
        for name in ("transport_delay", "output_nonlinearity")
    ]
    assert ratios == pytest.approx([np.sqrt(0.5)] * 2, rel=0.1)


def test_every_pair_and_every_group_is_beyond_the_limit(slow):
    pairs = slow.pairs()
    assert pairs
    assert all(pair.size > LARGE for pair in pairs)
    members = [name for group in slow.groups() for name in group]
    assert len(members) == len(set(members))
    assert set(members) == {name for pair in pairs for name in (pair.first, pair.second)}


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ("electrical_lag", "sensor_filter", "record the monitor voltage of the amplifier too"),
        ("sensor_filter", "electrical_lag", "record the monitor voltage of the amplifier too"),
        ("creep", "friction", "record the displacement of the stack too"),
        ("creep", "gain_drift", EFFECTS["creep"].separate_by),
    ],
)
def test_a_signal_between_two_locations_separates_what_lies_there(one, other, expected):
    assert separated_by(EFFECTS[one], EFFECTS[other]) == expected
