"""A recording that says how long its commands were held: what is late is told from what the course hides."""

from dataclasses import replace

import numpy as np
import pytest

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.selection.stated_hold import with_stated_hold
from piezod.effects import EFFECTS
from piezod.recording.hold import HELD_ONE_SAMPLE, Hold
from tests.unit.diagnose.residuals import lagged, mixed_work, noise, series, time
from tests.unit.diagnose.test_corners import many_plays

SAMPLES, RATE_HZ, FINE = 6_000, 200.0, 50
LAG_S, DELAY_S, NOISE_N = 0.008, 0.0064, 0.1
STRAIGHT = 0.1  # of a sample: a delay is taken straight between samples, where the force approaches in curves
HELD_A_SAMPLE_EARLIER = Hold("held", 1e-6)  # what the search takes for the course where everything is a sample late


def read(commands_V, delay_s):
    """Commands held, lagged and delayed on a grid fifty times as fine, read one step of it before the next command."""
    amplifier_V = lagged(np.repeat(commands_V, FINE), LAG_S, FINE * RATE_HZ)
    late = round(delay_s * RATE_HZ * FINE)
    delayed_V = np.concatenate((np.full(late, amplifier_V[0]), amplifier_V))[: amplifier_V.size]
    return many_plays(delayed_V[FINE - 1 :: FINE])


def chain_over(delay_s, *, recorded_hold):
    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(3), []
    for role in ("identification", "recording"):
        u = mixed_work(seconds)
        u = np.clip(u - u[0], 0.0, None)
        force_N = many_plays(u) if role == "identification" else read(u, delay_s)
        force_N += NOISE_N * noise(SAMPLES, 0.0, rng)
        told = recorded_hold if role == "recording" else None
        one = series(seconds, u, force_N, NOISE_N, role=role)
        made.append(replace(one, recorded_hold=told, hold=HELD_A_SAMPLE_EARLIER))
    return Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)


def with_a_filter(chain):
    """The lag of the amplifier, and a filter for what is later still."""
    terms = tuple(Term(EFFECTS[name], "since") for name in ("electrical_lag", "sensor_filter"))
    point = empty_point(chain, 1.8, 0.0)
    values = ({"time_constant_s": LAG_S, "swell": 0.0}, {"cutoff_Hz": 100.0})
    return fit(chain, terms, replace(point, values=values))


def test_a_filter_that_is_part_of_a_sample_gives_way_to_the_delay_that_the_told_course_needs():
    chain = chain_over(DELAY_S, recorded_hold=HELD_ONE_SAMPLE)
    _, found = with_stated_hold(chain, with_a_filter(chain))
    assert set(found.effects) == {"electrical_lag", "transport_delay"}
    values = dict(zip((term.effect.name for term in found.terms), found.point.values, strict=True))
    assert values["transport_delay"]["delay_s"] == pytest.approx(
        DELAY_S + 1.0 / (FINE * RATE_HZ), abs=STRAIGHT / RATE_HZ
    )
    assert values["electrical_lag"]["time_constant_s"] == pytest.approx(LAG_S, rel=0.05)


def test_a_recording_that_does_not_say_leaves_a_hypothesis_as_it_is():
    chain = chain_over(DELAY_S, recorded_hold=None)
    found = with_a_filter(chain)
    assert with_stated_hold(chain, found) == (chain, found)
