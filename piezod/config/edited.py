"""A YAML text with some values changed and every comment kept."""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from piezod.config.yaml_reader import Document
from piezod.errors import ConfigurationError

_PLAIN = re.compile(r"[A-Za-z_/](?:[\w./:@+-]*[\w/])?")

Scalar = str | float | int | bool | None


def edited(path: Path, text: str, changes: Mapping[tuple[str, ...], Scalar]) -> str:
    """Change values in place.

    Parameters
    ----------
    path
        Of the text, for messages.
    text
        YAML.
    changes
        New values by path, such as `{("link", "host"): "10.0.0.7"}`; each must be a single value in the text.

    Raises
    ------
    ConfigurationError
        The text has no such key, or it holds no single value.
    """
    document = Document(path, text)
    spans = []
    for keys, value in changes.items():
        span = document.span_of(keys)
        if span is None:
            raise ConfigurationError(f"{path}: has no value {'.'.join(keys)} that could be changed")
        spans.append((*span, _scalar(value)))
    for start, end, value in sorted(spans, reverse=True):
        line_end = text.find("\n", end)
        rest = text[end : line_end if line_end >= 0 else len(text)]
        text = text[:start] + value + _moved(rest, end - start - len(value)) + text[end + len(rest) :]
    return text


def _moved(rest: str, by: int) -> str:
    """What stands behind a value, its comment in the column where it was, if that is free."""
    words = rest.lstrip(" ")
    if not words.startswith("#"):
        return rest
    return " " * max(1, len(rest) - len(words) + by) + words


def _scalar(value: Scalar) -> str:
    plain = isinstance(value, str) and _PLAIN.fullmatch(value) is not None and value not in ("true", "false", "null")
    return str(value) if plain else json.dumps(value)  # YAML reads JSON's scalars as JSON does
