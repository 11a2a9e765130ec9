"""Replacement of values in a YAML text; comments and layout stay."""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from piezod.config.yaml_reader import Document
from piezod.errors import ConfigurationError

_PLAIN = re.compile(r"[A-Za-z_/](?:[\w./:@+-]*[\w/])?")

Scalar = str | float | int | bool | None


def replace_values(path: Path, text: str, changes: Mapping[tuple[str, ...], Scalar]) -> str:
    """The YAML text with new values at the given keys.

    Parameters
    ----------
    changes
        New values by path, such as `{("link", "host"): "10.0.0.7"}`. Each path must lead to a scalar in the text.

    Raises
    ------
    ConfigurationError
        The text has no such key, or its value is a list or a mapping.
    """
    document = Document(path, text)
    spans = []
    for keys, value in changes.items():
        span = document.span_of(keys)
        if span is None:
            raise ConfigurationError(f"{path}: has no single value {'.'.join(keys)}, cannot be changed")
        spans.append((*span, _scalar(value)))
    for start, end, value in sorted(spans, reverse=True):
        line_end = text.find("\n", end)
        rest = text[end : line_end if line_end >= 0 else len(text)]
        text = text[:start] + value + _aligned(rest, end - start - len(value)) + text[end + len(rest) :]
    return text


def _aligned(rest: str, shift: int) -> str:
    """The rest of the line after a value; a comment stays in its column if the new value leaves room."""
    words = rest.lstrip(" ")
    if not words.startswith("#"):
        return rest
    return " " * max(1, len(rest) - len(words) + shift) + words


def _scalar(value: Scalar) -> str:
    plain = isinstance(value, str) and _PLAIN.fullmatch(value) is not None and value not in ("true", "false", "null")
    return str(value) if plain else json.dumps(value)  # every JSON scalar is also a YAML scalar of equal value
