"""Strict YAML: no duplicate keys, no aliases, no dates or octal numbers, a size limit, the line of every key."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from firmware_sim.errors import ConfigurationError

LARGEST_BYTES = 1_000_000
DEEPEST = 20

Value = bool | int | float | str | list["Value"] | dict[str, "Value"] | None
Place = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_FLOAT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_WORDS: dict[str, bool | None] = {"true": True, "false": False, "null": None, "~": None, "": None}


@dataclass(frozen=True)
class Document:
    """Content of a file, and the line of every key (from 1)."""

    name: str
    content: dict[str, Value]
    lines: dict[Place, int]

    def line(self, place: Place) -> int:
        """Return the line of a key, or of the nearest key above it."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)


def read_document(path: Path) -> Document:
    """Read a YAML mapping.

    Parameters
    ----------
    path
        YAML file of at most `LARGEST_BYTES` bytes.

    Raises
    ------
    ConfigurationError
        The file is missing, too large, not YAML, not a mapping, or repeats a key.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"{path}:1: cannot be read: {error.strerror}") from None
    if len(raw) > LARGEST_BYTES:
        raise ConfigurationError(f"{path}:1: has {len(raw)} bytes, must be at most {LARGEST_BYTES}")
    try:
        text = raw.decode("utf-8")
        _refuse_aliases(path, text)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}:1: is not UTF-8 text") from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigurationError(f"{path}:{line}: {error.problem or 'is not YAML'}") from None
    except yaml.YAMLError:
        raise ConfigurationError(f"{path}:1: is not YAML text") from None
    lines: dict[Place, int] = {}
    content = _Walk(str(path), lines).value(root, ()) if root is not None else {}
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}:1: must be a mapping of keys to values")
    return Document(str(path), content, lines)


def checked(model: type[Model], document: Document) -> Model:
    """Validate a document against a model.

    Parameters
    ----------
    model
        Class of the result.
    document
        YAML mapping with the line of every key.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and reason.
    """
    try:
        return model.model_validate(document.content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = tuple(first["loc"])
        key = ".".join(str(part) for part in place) or "the file"
        what = first["msg"].removeprefix("Value error, ")
        shown = "" if isinstance(first["input"], dict) else f" is {str(first['input'])[:60]!r}"
        raise ConfigurationError(f"{document.name}:{document.line(place)}: {key}{shown}: {what}") from None


@dataclass(frozen=True)
class _Walk:
    """Converts YAML nodes to plain values, and records their lines."""

    name: str
    lines: dict[Place, int]

    def value(self, node: yaml.Node, place: Place) -> Value:
        if len(place) > DEEPEST:
            raise ConfigurationError(f"{self.name}:{node.start_mark.line + 1}: nested deeper than {DEEPEST} levels")
        self.lines.setdefault(place, node.start_mark.line + 1)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, place)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, (*place, index)) for index, child in enumerate(node.value)]
        return _scalar(node)

    def _mapping(self, node: yaml.MappingNode, place: Place) -> dict[str, Value]:
        found: dict[str, Value] = {}
        for key_node, child in node.value:
            key, line = str(key_node.value), key_node.start_mark.line + 1
            if key in found:
                raise ConfigurationError(f"{self.name}:{line}: the key '{key}' appears twice")
            self.lines[(*place, key)] = line
            found[key] = self.value(child, (*place, key))
        return found


def _refuse_aliases(path: Path, text: str) -> None:
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise ConfigurationError(f"{path}:{line}: alias *{event.anchor} is not allowed; write the value out")


def _scalar(node: yaml.Node) -> Value:
    text = str(node.value)
    if isinstance(node, yaml.ScalarNode) and node.style in ("'", '"', "|", ">"):
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
