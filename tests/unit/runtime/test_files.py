"""Files that are written whole: links, modes, full disks and what stands at the name."""

import os
import stat

import pytest

from piezod.errors import ConfigurationError
from piezod.runtime import files
from piezod.runtime.files import replaced, written


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_replaced_whole_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a.json"
    written(path, "one")
    written(path, b"two")
    assert (path.read_bytes(), names(tmp_path)) == (b"two", ["a.json"])


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_the_mode_of_a_replaced_file_stays(tmp_path, mode):
    path = tmp_path / "model.yaml"
    path.touch()
    path.chmod(mode)
    written(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_a_new_file_has_the_mode_that_the_mask_gives(tmp_path):
    before = os.umask(0o027)
    try:
        written(tmp_path / "new", "")
        written(tmp_path / "secret", "", mode=0o600)
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("new", "secret")] == [0o640, 0o600]


def test_links_at_every_guessable_name_lead_to_no_foreign_file(tmp_path):
    foreign, path = tmp_path / "foreign", tmp_path / "model.yaml"
    foreign.write_text("mine")
    for name in (f".model.yaml.{os.getpid()}", f".{os.getpid()}.model.yaml", "model.yaml", "model.yaml.tmp"):
        (tmp_path / name).symlink_to(foreign)
    written(path, "new")
    assert (foreign.read_text(), path.read_text(), path.is_symlink()) == ("mine", "new", False)


def test_a_link_at_the_temporary_name_itself_is_refused(tmp_path, monkeypatch):
    foreign = tmp_path / "foreign"
    foreign.write_text("mine")
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: "known")
    (tmp_path / ".known.a").symlink_to(foreign)
    with pytest.raises(ConfigurationError, match="cannot be written"):
        written(tmp_path / "a", "new")
    assert foreign.read_text() == "mine"


@pytest.mark.parametrize("kind", ["fifo", "folder", "link to a fifo", "link to a folder"])
def test_what_is_no_file_is_not_replaced_and_does_not_block(tmp_path, kind):
    thing = tmp_path / "thing"
    thing.mkdir() if "folder" in kind else os.mkfifo(thing)
    path = tmp_path / "path" if "link" in kind else thing
    if "link" in kind:
        path.symlink_to(thing)
    with pytest.raises(ConfigurationError, match=f"{path}: cannot be written: "):
        written(path, "new")
    assert not thing.is_file()
    assert len(names(tmp_path)) == 1 + ("link" in kind)


@pytest.mark.parametrize("step", ["write", "fsync", "replace"])
def test_an_error_at_any_step_leaves_the_file_of_before_and_one_line(tmp_path, monkeypatch, step):
    path = tmp_path / "a"
    written(path, "old")

    def full(*_):
        raise OSError(28, "No space left on device")

    owner, name = {"write": (files.Path, "write_bytes"), "fsync": (os, "fsync"), "replace": (files.Path, "replace")}[
        step
    ]
    monkeypatch.setattr(owner, name, full)
    with pytest.raises(ConfigurationError, match=f"^{path}: cannot be written: No space left on device$"):
        written(path, "new")
    assert (path.read_text(), names(tmp_path)) == ("old", ["a"])


def test_the_content_is_on_the_disk_before_the_name_and_the_folder_after_it(tmp_path, monkeypatch):
    steps = []
    fsync, replace = os.fsync, files.Path.replace

    def noted_fsync(descriptor):
        steps.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def noted_replace(part, path):
        steps.append("name")
        return replace(part, path)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(files.Path, "replace", noted_replace)
    written(tmp_path / "a", "new")
    assert steps == ["file", "name", "folder"]


def test_an_existing_file_is_not_replaced_without_force(tmp_path):
    written(tmp_path / "a", "old")
    with pytest.raises(FileExistsError):
        written(tmp_path / "a", "new", force=False)
    assert ((tmp_path / "a").read_text(), names(tmp_path)) == ("old", ["a"])


def test_a_part_keeps_the_suffix_and_a_long_name_fits(tmp_path):
    with replaced(tmp_path / ("x" * 250 + ".mf4")) as part:
        assert part.suffix == ".mf4"
    assert names(tmp_path) == ["x" * 250 + ".mf4"]
