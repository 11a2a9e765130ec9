"""A compiled step is removed from the cache when a source file is newer."""

import os
from pathlib import Path

from piezod.model import law_inverse
from piezod.model.chain import compiled_steps, tick_chain
from piezod.model.chain.compiled_steps import CALLED
from piezod.model.unnamed_law import LawStep, UnnamedLaw
from piezod.operators import compiled_cache
from piezod.operators.compiled_cache import forget_outdated_steps
from tests.unit.model.chains import held_model, with_effects

LAW = {
    "drivers": ({"driver": "command", "low": 0.0, "high": 140.0, "nodes": 2},),
    "dead_band": 1.0,
    "smoothing_s": 0.003,
    "memories_s": (0.0,),
    "tables": [[0.0, 1.0]],
}


def test_a_step_older_than_a_source_is_removed_and_a_newer_step_stays(tmp_path):
    newest_s = max(source.stat().st_mtime for source in Path(compiled_cache.__file__).parent.glob("*.py"))
    old, new = tmp_path / "old.nbi", tmp_path / "new.nbi"
    for path, age_s in ((old, -1.0), (new, 1.0)):
        path.touch()
        os.utime(path, (newest_s + age_s, newest_s + age_s))
    forget_outdated_steps(str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["new.nbi"]


def test_a_step_is_removed_when_a_step_that_it_calls_in_another_folder_is_newer(tmp_path):
    called, cache = tmp_path / "called", tmp_path / "cache"
    for folder in (called, cache):
        folder.mkdir()
    step, source = cache / "chain.nbi", called / "play.py"
    for path, modified_s in ((step, 100.0), (source, 200.0)):
        path.touch()
        os.utime(path, (modified_s, modified_s))
    forget_outdated_steps(str(cache), (called,))
    assert not step.exists()


def test_the_inverse_chain_watches_operators_effects_and_itself():
    rooms = {path.name for path in CALLED}
    assert rooms == {"operators", "effects", "chain"}
    assert all(any(path.glob("*.py")) for path in CALLED)


def test_every_cache_of_a_chain_with_effects_and_law_is_watched(monkeypatch):
    watched = set()
    for module in (compiled_steps, tick_chain, law_inverse):
        monkeypatch.setattr(module, "forget_outdated_steps", lambda path, _called: watched.add(Path(path).parent.name))
    compiled_steps.address_of.cache_clear()
    chain = tick_chain.TickChain(with_effects(held_model(), "creep"), 1e-3)
    law_inverse.LawInverse(LawStep(UnnamedLaw.model_validate(LAW), 1e-3), chain)
    assert watched == {"effects", "chain", "model"}
