"""Commands that show whether minor loops depend on the bias, and commands that cannot."""

import itertools

import numpy as np
import pytest

from piezod.effects.noncongruent_minor_loops import shown_by
from tests.benches.plain_stack import triangles, work

TIME_S = np.arange(0.0, 20.0, 0.005)


def through(*levels_V):
    return np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(levels_V)])


@pytest.mark.parametrize(
    ("command_V", "shown"),
    [
        (50.0 - 50.0 * np.cos(2 * np.pi * TIME_S), False),  # one amplitude
        (50.0 - np.linspace(5.0, 50.0, TIME_S.size) * np.cos(2 * np.pi * TIME_S), False),  # growing about one bias
        (through(0, 100, 0), False),  # the major loop
        (through(0, 30, 10, 60, 40, 90, 70, 100, 0), True),  # loops of 20 V at 20, 50 and 80 V
        (triangles([100.0, 95.0, 90.0]), False),  # from one end to nearly the same peak
        (work(3), True),
        (through(50, 0, 100, 0), False),  # falls first
        (np.zeros(50), False),
    ],
)
def test_alike_loops_at_different_biases(command_V, shown):
    assert shown_by(np.ascontiguousarray(command_V)) is shown


def test_noise_of_a_measured_command_turns_nothing():
    noise_V = np.random.default_rng(1).normal(0.0, 0.2, TIME_S.size)
    assert not shown_by(50.0 - 50.0 * np.cos(2 * np.pi * TIME_S) + noise_V)
