"""Adding an effect is one file and one line: a made-up effect, put into the catalogue, acts everywhere."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from piezod.diagnose.candidates.starts import catalogue_starts
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.terms import Term
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect, Location
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Tick
from piezod.model import ExtendedCompensator
from piezod.model.chain.forward import run_chain
from piezod.model.expected import ExpectedReading
from tests.unit.diagnose.test_search import worked
from tests.unit.model.chains import DT_S, held_model, with_effects

SHARE, SLOW_V = range(2)  # memory
KEEP = 0.9  # of the slow part, from sample to sample


@numba.njit
def _run(stroke_V, share):
    out, slow_V = np.empty(stroke_V.size), stroke_V[0]
    for k in range(stroke_V.size):
        slow_V = KEEP * slow_V + (1.0 - KEEP) * stroke_V[k]
        out[k] = stroke_V[k] + share * slow_V
    return out


def _advance(own, _shared, stroke_V):
    own[SLOW_V] = KEEP * own[SLOW_V] + (1.0 - KEEP) * stroke_V
    return stroke_V + own[SHARE] * own[SLOW_V]


def _invert(own, _shared, stroke_V):
    return (stroke_V - own[SHARE] * KEEP * own[SLOW_V]) / (1.0 + own[SHARE] * (1.0 - KEEP))


def _settle(own, _shared, stroke_V):
    own[SLOW_V] = stroke_V
    return stroke_V * (1.0 + own[SHARE])


SPONGE = Effect(
    name="sponge",
    title="a layer that gives way",
    location=Location.STACK,
    form="linear",
    parameters=(Parameter("share", "1", 0.0, 1.0, Search((0.2,))),),
    forward=lambda signal, _context, values: _run(signal, values["share"]),
    handling="compensated",
    tick=Tick(lambda values, _setting: np.array([values["share"], 0.0]), _advance, _invert, _settle),
    docstring=__doc__,
)


@pytest.fixture
def model(monkeypatch):
    monkeypatch.setitem(EFFECTS, SPONGE.name, SPONGE)
    return with_effects(held_model(), SPONGE.name)


def test_a_new_effect_acts_in_the_record_in_the_expected_reading_and_in_the_inverse(model):
    t = np.arange(0.0, 2.0, DT_S)
    wanted_N = 80.0 - 60.0 * np.cos(2.0 * np.pi * 1.5 * t)
    compensator = ExtendedCompensator(model, DT_S)
    voltage_V = np.empty(t.size)
    for k, force_N in enumerate(compensator.ahead(wanted_N, loop=False)):
        voltage_V[k] = compensator.plan(force_N)
        compensator.commit(voltage_V[k])
    expected_N, _ = ExpectedReading(model, DT_S).run(voltage_V, np.zeros(t.size))
    np.testing.assert_allclose(expected_N, wanted_N, atol=1e-8)
    from_rest_V = np.concatenate(([0.0], voltage_V))
    record_N = run_chain(model, model.operator(), np.arange(from_rest_V.size) * DT_S, from_rest_V)
    np.testing.assert_allclose(record_N[1:], wanted_N, atol=1e-8)


def test_a_new_effect_is_a_candidate_of_the_search_and_is_fitted(monkeypatch):
    monkeypatch.setitem(EFFECTS, SPONGE.name, SPONGE)

    def missing(force_N, _u, role):
        return force_N if role == "identification" else _run(force_N, 0.3)

    chain, start = worked(np.random.default_rng(5), missing)
    base = fit(chain, (), start)
    effect, values, _ = next(start for start in catalogue_starts(chain, [], {}) if start[0] is SPONGE)
    fitted = fit(chain, (Term(effect, "since"),), replace(base.point, values=(values,)))
    assert fitted.point.values[0]["share"] == pytest.approx(0.3, abs=0.01)
    assert fitted.loss < 1.05 < base.loss
