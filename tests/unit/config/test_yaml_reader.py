"""Configuration files that are no text, use tags, or cannot exist: one line, and no exception of PyYAML."""

from pathlib import Path

import pytest

from piezod.config import read_document
from piezod.errors import ConfigurationError, RecordingError


def refused(tmp_path, content):
    path = tmp_path / "bench.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        read_document(path)
    text = str(caught.value)
    assert text.isprintable()
    return text.replace(str(path), "bench.yaml")


@pytest.mark.parametrize("byte", [0, 1, 27])
def test_a_sign_that_is_no_text_is_refused_with_its_line(tmp_path, byte):
    said = refused(tmp_path, b"a: 1\nb: x" + bytes([byte]) + b"\n")
    assert said == f"bench.yaml:2: character {byte:#x} is not allowed in YAML; remove it, or save the file as text"


@pytest.mark.parametrize(
    "tagged",
    ["!!int ''", "!!float ''", "!!bool x", "!!timestamp x", "!!int '3'", "!!set {a}", "! x", "!!python/name:os.system"],
)
def test_a_tag_is_refused_with_its_place(tmp_path, tagged):
    assert refused(tmp_path, f"a: 1\nb: {tagged}\n".encode()).startswith("bench.yaml:2:4: not valid YAML: a tag")


def test_escape_sequences_of_a_file_reach_no_terminal(tmp_path):
    said = refused(tmp_path, b'"a\\e[31m\\n": 1\n"a\\e[31m\\n": 2\n')
    assert "key 'a\\x1b[31m\\n' stands twice" in said


@pytest.mark.parametrize("name", ["a\0b.yaml", "a\ud800.yaml"])
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(ConfigurationError, match="no file has such a name"):
        read_document(Path(name))


def test_a_message_is_one_printable_line():
    assert str(RecordingError("ch\u00b5\n\x1b[0m\ud800 \u00b0C")) == "ch\u00b5\\n\\x1b[0m\\ud800 \u00b0C"
