"""Stuck readings, and others that look similar: constant commands, coarse converters, dry friction, slow sensors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.estimation.recordings.stuck import find_stuck
from piezod.excitation import constant_triangles, staircase_minor_loops_multisine
from piezod.operators import PrandtlIshlinskii
from piezod.recording.stretches import BLOCK, long_runs

RATE_HZ = 200.0
TRIANGLES = constant_triangles(140.0, 0.2, 5, RATE_HZ)


def force(drive):
    """A loop like a stack's, to about 300 N."""
    return PrandtlIshlinskii([0.0, 5.0, 20.0, 50.0], [1.0, 0.1, 0.1, 0.2], [0.0], [2.0]).run(drive)


def held_by_friction(drive, width=10.0):
    """Reading that is constant after each reversal until the drive has moved by twice the width."""
    held = [0.0]
    for u in drive.tolist():
        held.append(max(u - width, min(u + width, held[-1])))
    return 2.0 * np.array(held[1:])


def noise(n, size, seed=1):
    return np.random.default_rng(seed).normal(0.0, size, n)


def coarse(values, bits, swing=None):
    step = (np.ptp(values) if swing is None else swing) / (2**bits - 1)
    return np.round(values / step) * step


def sine(n=20_000):
    return 70.0 - 70.0 * np.cos(2 * np.pi * np.arange(n) / 4000)


def with_dwells(drive, each=500, long=300):
    """The drive, held for `long` samples after every `each`."""
    return np.concatenate(
        [np.concatenate((part, np.full(long, part[-1]))) for part in np.array_split(drive, drive.size // each)]
    )


DRIVES = {
    "triangles": TRIANGLES,
    "slow triangles": constant_triangles(140.0, 0.01, 2, RATE_HZ),
    "dwells": with_dwells(TRIANGLES),
    "sine": sine(),
    "staircase, loops, multisine": staircase_minor_loops_multisine(140.0, 0.2, 1, RATE_HZ),
    "steps": np.repeat([0.0, 20.0, 80.0, 140.0, 90.0, 30.0, 110.0, 0.0], 700),
}


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES.keys())
@pytest.mark.parametrize("bits", [None, 16, 12, 8, 6])
@pytest.mark.parametrize("spread", [0.0, 0.001, 0.01])
def test_a_sound_reading_is_not_stuck_whatever_the_drive_the_converter_and_the_noise(drive, bits, spread):
    values = force(drive) + noise(drive.size, spread * 300.0) if spread else force(drive)
    values = values if bits is None else coarse(values, bits)
    assert find_stuck(values, drive).stretches == []
    assert find_stuck(values, drive + noise(drive.size, 0.1, seed=2)).stretches == []


@pytest.mark.parametrize("delay", [1, 20])
def test_a_reading_that_follows_a_staircase_late_is_not_frozen(delay):
    drive = DRIVES["steps"]
    late = coarse(force(np.concatenate((np.zeros(delay), drive[:-delay]))), 12)
    assert find_stuck(late, drive).stretches == []


def test_a_sensor_with_a_slow_update_rate_is_not_frozen():
    values = force(TRIANGLES) + noise(TRIANGLES.size, 0.3)
    assert find_stuck(np.repeat(values[::40], 40)[: values.size], TRIANGLES).stretches == []


def test_dry_friction_that_holds_the_stack_after_each_reversal_is_not_frozen():
    drive = sine()
    values = coarse(held_by_friction(drive), 16)
    assert long_runs(values, 100)[0].size >= 9
    assert find_stuck(values, drive).stretches == []


def test_a_temperature_that_hardly_changes_is_not_frozen():
    temperature = np.round(21.0 + np.linspace(0.0, 0.3, TRIANGLES.size) + noise(TRIANGLES.size, 0.01), 1)
    assert find_stuck(temperature, TRIANGLES).stretches == []


@pytest.mark.parametrize("bits", [None, 12])
@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize("stretch", [(1000, 1200), (2600, 2840), (3000, 4990)])
def test_a_frozen_sensor_is_found_to_the_sample(bits, spread, stretch):
    values = force(TRIANGLES) + (noise(TRIANGLES.size, spread) if spread else 0.0)
    values = values if bits is None else coarse(values, bits)
    start, stop = stretch
    values[start:stop] = values[start] = 0.5 * (values.min() + values.max()) + 1e-3
    assert find_stuck(values, TRIANGLES).frozen == [stretch]


@pytest.mark.parametrize("bits", [None, 12])
@pytest.mark.parametrize("spread", [0.0, 0.3])
@pytest.mark.parametrize(("rail", "kind"), [((-np.inf, 250.0), "at_largest"), ((40.0, np.inf), "at_smallest")])
def test_clipping_is_found_at_either_end_of_the_range(bits, spread, rail, kind):
    drive = with_dwells(TRIANGLES, 777)
    values = force(drive) + (noise(drive.size, spread) if spread else 0.0)
    values = np.clip(values if bits is None else coarse(values, bits), *rail)
    extreme = values.max() if kind == "at_largest" else values.min()
    found = find_stuck(values, drive)
    masked = sum(stop - start for start, stop in getattr(found, kind))
    assert masked >= 0.98 * np.count_nonzero(values == extreme) - 20
    assert all((values[start:stop] == extreme).all() for start, stop in getattr(found, kind))
    assert found.frozen == []


def test_a_reading_of_opposite_sign_gives_the_same_stretches():
    values = np.minimum(coarse(force(TRIANGLES), 12), 250.0)
    assert find_stuck(-values, TRIANGLES).at_smallest == find_stuck(values, TRIANGLES).at_largest != []


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(1, 9)), min_size=1, max_size=50), st.integers(1, 8))
def test_long_runs_are_equal_to_those_found_by_counting(runs, at_least):
    values = np.concatenate([np.full(length, float(value)) for value, length in runs])
    expected, start = [], 0
    for k in range(1, values.size + 1):
        if k == values.size or values[k] != values[start]:
            expected += [(start, k)] if k - start >= at_least else []
            start = k
    assert list(zip(*map(list, long_runs(values, at_least)), strict=True)) == expected


def test_a_run_across_blocks_is_found_as_a_single_run():
    values = np.arange(2.0 * BLOCK + 10)
    values[BLOCK - 7 : 2 * BLOCK + 5] = -1.0
    values[-3:] = -2.0
    starts, stops = long_runs(values, 3)
    assert list(zip(starts.tolist(), stops.tolist(), strict=True)) == [
        (BLOCK - 7, 2 * BLOCK + 5),
        (2 * BLOCK + 7, 2 * BLOCK + 10),
    ]
