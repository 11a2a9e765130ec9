"""A compiled step is removed from the cache when a source file is newer."""

import os
from pathlib import Path

from piezod.model.chain.compiled_steps import CALLED
from piezod.operators import compiled_cache
from piezod.operators.compiled_cache import forget_outdated_steps


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
