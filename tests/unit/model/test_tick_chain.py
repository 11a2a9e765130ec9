"""The chain of the tick: what it compiles before the first tick, and where its addresses hold."""

import pickle

import numpy as np
import pytest

from piezod.model.chain import tick_chain
from piezod.model.chain.tick_chain import TickChain
from tests.unit.model.chains import DT_S, held_model, with_effects


def test_a_chain_with_a_temperature_compiles_its_step_when_it_is_built(monkeypatch):
    values = []
    monkeypatch.setattr(tick_chain, "measure_chain", lambda _program, _state, value: values.append(value))
    TickChain(with_effects(held_model(), "thermal_drift"), DT_S)
    TickChain(with_effects(held_model(), "creep"), DT_S)
    assert np.isnan(values).tolist() == [True]


def test_a_chain_is_not_passed_to_another_process():
    with pytest.raises(TypeError, match="addresses of this process"):
        pickle.dumps(TickChain(with_effects(held_model(), "creep"), DT_S))
