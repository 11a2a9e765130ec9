"""Strict YAML reader: each value has one possible meaning.

PyYAML by default accepts duplicate keys and reads `12:30` as 750, `0400` as 256 and `no` as false.
This reader accepts decimal numbers, `true` and `false`. It refuses duplicate keys, aliases and tags.
Each error message names file and line.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError

MAX_BYTES = 1 << 20  # a configuration or a model has some kilobytes
MAX_DEPTH = 32


class _StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalar types of YAML 1.2."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:  # noqa: ANN401  of PyYAML
        """Refuse tags: a tag changes the type of a value."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "tag", None) is not None:
            raise yaml.composer.ComposerError(None, None, "a tag (!name); write the plain value", event.start_mark)
        return super().compose_node(parent, index)


_StrictLoader.yaml_implicit_resolvers = {}
_RESOLVERS: tuple[tuple[str, str, str], ...] = (
    ("null", r"^(?:~|null|)$", "~n\0"),
    ("bool", r"^(?:true|false)$", "tf"),
    ("int", r"^(?:[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+)$", "-+0123456789"),
    (
        "float",
        r"^(?:[-+]?(?:0|[1-9][0-9]*)(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?|[-+]?\.[0-9]+(?:[eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan)$",
        "-+.0123456789",
    ),
)
for _tag, _pattern, _first in _RESOLVERS:
    _StrictLoader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), [c if c != "\0" else "" for c in _first]
    )


class Document:
    """A YAML mapping with the line number of each key."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        try:
            loader = _StrictLoader(text)
        except yaml.reader.ReaderError as error:
            raise ConfigurationError(_character_message(path, text, error)) from error
        try:
            self._root = loader.get_single_node()
            _refuse_ambiguities(self._root, path)
            self.content: Any = loader.construct_document(self._root) if self._root is not None else None
        except yaml.YAMLError as error:
            raise ConfigurationError(_syntax_message(path, error)) from error
        except (ValueError, RecursionError) as error:
            raise ConfigurationError(f"{path}: not readable as YAML: {error}") from error
        finally:
            loader.dispose()
        if not isinstance(self.content, Mapping):
            raise ConfigurationError(f"{path}: holds {_kind(self.content)}, must be a mapping of keys to values")

    def line_of(self, keys: Sequence[str | int]) -> int:
        """Line number (from 1) of the value at the path `keys`; if absent, of its nearest parent."""
        node, line = self._root, 1
        for key in keys:
            child = _child(node, key)
            if child is None:
                break
            line, node = child
        return line

    def span_of(self, keys: Sequence[str]) -> tuple[int, int] | None:
        """Start and end index of the scalar at the path `keys` in the text; None: no scalar there."""
        node = self._root
        for key in keys:
            if not isinstance(node, yaml.MappingNode):
                return None
            node = next((value for name, value in node.value if name.value == key), None)
        return (node.start_mark.index, node.end_mark.index) if isinstance(node, yaml.ScalarNode) else None


def read_document(path: Path, schema: bytes = b"") -> Document:
    """Read one YAML file.

    Parameters
    ----------
    schema
        As for `open_regular`.

    Raises
    ------
    ConfigurationError
        The file is missing, unreadable, above 1 MiB, not UTF-8 or not YAML, or it has aliases or duplicate keys.
    """
    with open_regular(path, MAX_BYTES, schema) as file:
        try:
            raw = file.read(MAX_BYTES)
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: byte {error.start} is not UTF-8 text") from error
    return Document(path, text)


def _refuse_ambiguities(root: yaml.Node | None, path: Path) -> None:
    """Refuse aliases, duplicate keys, keys that are not scalars, and more than `MAX_DEPTH` levels."""
    seen: set[int] = set()
    pending = [(root, 0)]
    while pending:
        node, depth = pending.pop()
        if node is None:
            continue
        line = node.start_mark.line + 1
        if id(node) in seen:
            raise ConfigurationError(f"{path}:{line}: uses an alias (*name); write the value out")
        if depth > MAX_DEPTH:
            raise ConfigurationError(f"{path}:{line}: nested deeper than {MAX_DEPTH} levels")
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            _refuse_duplicate_keys(node, path)
            pending.extend((value, depth + 1) for _, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            pending.extend((value, depth + 1) for value in node.value)


def _refuse_duplicate_keys(node: yaml.MappingNode, path: Path) -> None:
    lines: dict[str, int] = {}
    for key, _ in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise ConfigurationError(f"{path}:{line}: a key must be a single word")
        if key.value in lines:
            raise ConfigurationError(
                f"{path}:{line}: key '{key.value}' appears twice, first on line {lines[key.value]}; remove one"
            )
        lines[key.value] = line


def _child(node: yaml.Node | None, key: str | int) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            if name.value == key:
                return name.start_mark.line + 1, value
    elif isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
        return node.value[key].start_mark.line + 1, node.value[key]
    return None


def _syntax_message(path: Path, error: yaml.YAMLError) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        return f"{path}:{mark.line + 1}:{mark.column + 1}: not valid YAML: {error.problem}"
    return f"{path}: not valid YAML: {' '.join(str(error).split())}"


def _character_message(path: Path, text: str, error: yaml.reader.ReaderError) -> str:
    line = text.count("\n", 0, error.position) + 1
    return f"{path}:{line}: character {error.character:#x} is not allowed in YAML; remove it, or save the file as text"


def _kind(value: object) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"
