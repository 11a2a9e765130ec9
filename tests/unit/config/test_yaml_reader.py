"""Files that are not strict YAML are refused with one line, without an exception of PyYAML."""

from pathlib import Path

import pytest

from piezod.config import read_document
from piezod.errors import ConfigurationError, RecordingError


def refused(tmp_path, content):
    path = tmp_path / "bench.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        read_document(path)
    message = str(caught.value)
    assert message.isprintable()
    return message.replace(str(path), "bench.yaml")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds nothing, must be a mapping"),
        (b"- 1\n", "holds a list, must be a mapping"),
        (b"\xff\xfe\x00", "byte 0 is not UTF-8"),
        (b"a: " + b"[" * 5000, "not"),
        (b"x: " + b"y" * (1 << 20), "must have at most 1048576"),
        (b"? {a: 1}\n: 2\n", "a key must be a single word"),
    ],
)
def test_a_file_without_a_valid_mapping_is_refused_in_one_line(tmp_path, content, message):
    assert message in refused(tmp_path, content)


@pytest.mark.parametrize("byte", [0, 1, 27])
def test_a_control_character_is_refused_with_its_line(tmp_path, byte):
    message = refused(tmp_path, b"a: 1\nb: x" + bytes([byte]) + b"\n")
    assert message == f"bench.yaml:2: character {byte:#x} is not allowed in YAML; remove it, or save the file as text"


@pytest.mark.parametrize(
    "tagged",
    ["!!int ''", "!!float ''", "!!bool x", "!!timestamp x", "!!int '3'", "!!set {a}", "! x", "!!python/name:os.system"],
)
def test_a_tag_is_refused_with_line_and_column(tmp_path, tagged):
    assert refused(tmp_path, f"a: 1\nb: {tagged}\n".encode()).startswith("bench.yaml:2:4: not valid YAML: a tag")


def test_escape_sequences_of_a_file_are_escaped_in_the_message(tmp_path):
    message = refused(tmp_path, b'"a\\e[31m\\n": 1\n"a\\e[31m\\n": 2\n')
    assert "key 'a\\x1b[31m\\n' appears twice" in message


@pytest.mark.parametrize("name", ["a\0b.yaml", "a\ud800.yaml"])
def test_an_impossible_file_name_is_refused(name):
    with pytest.raises(ConfigurationError, match="no file has such a name"):
        read_document(Path(name))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(ConfigurationError, match="cannot be read"):
            read_document(path)


def test_an_error_message_is_one_printable_line():
    assert str(RecordingError("ch\u00b5\n\x1b[0m\ud800 \u00b0C")) == "ch\u00b5\\n\\x1b[0m\\ud800 \u00b0C"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "stack.yaml").write_text("schema: piezod.model/1\n", encoding="utf-8")
    (tmp_path / "bench.yaml").write_text("schema: piezod.bench/1\n", encoding="utf-8")
    return tmp_path


def missing(path, schema=b""):
    with pytest.raises(ConfigurationError) as caught:
        read_document(path, schema)
    return str(caught.value)


def test_a_misspelt_file_name_brings_the_one_beside_it(folder):
    assert missing(folder / "bnech.yaml").endswith("No such file or directory; did you mean 'bench.yaml'?")


def test_the_only_model_beside_a_missing_one_is_named_whatever_its_name(folder):
    assert missing(folder / "model.yaml", b"piezod.model/").endswith("did you mean 'stack.yaml'?")


def test_nothing_is_named_where_nothing_is_alike(folder):
    (folder / "other.yaml").write_text("schema: piezod.model/1\n", encoding="utf-8")
    assert missing(folder / "zzz.yaml", b"piezod.model/").endswith("No such file or directory")
    assert missing(folder / "nowhere" / "model.yaml").endswith("No such file or directory")
