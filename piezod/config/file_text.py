"""Text of a bench file: the comment of each key, and new values that leave comments and layout as they are."""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from piezod.config.yaml_reader import Document
from piezod.errors import ConfigurationError

_KEY = re.compile(r"^(?P<indent>(?:# )?\s*)(?P<key>[A-Za-z_][A-Za-z0-9_]*):(?P<rest>.*)$")
_COMMENT = re.compile(r"(?:^|\s)#\s*(?P<words>.*)$")
_CONTINUED = re.compile(r"^\s{8,}#\s*(?P<words>.*)$")


def comments_of(text: str) -> dict[str, str]:
    """Comments after the keys of a YAML text, by dotted path.

    Parameters
    ----------
    text
        A bench file formatted like `config/bench.yaml`: one key per line, followed by its comment. Further lines of
        comment may follow, indented by at least eight columns. A section that is commented out is read too.

    Returns
    -------
    dict
        For example `{"limits.slew_V_per_s": "at most current_max_A / capacitance_F"}`.
        Keys without a comment are omitted.
    """
    comments: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    path = ""
    for line in text.splitlines():
        continued = _CONTINUED.match(line)
        if continued and path in comments:
            comments[path] += " " + continued["words"].strip()
            continue
        match = _KEY.match(line)
        if match is None:
            path = ""
            continue
        indent = len(match["indent"].removeprefix("# "))
        above = [(depth, key) for depth, key in above if depth < indent]
        path = ".".join([*(key for _, key in above), match["key"]])
        above.append((indent, match["key"]))
        comment = _COMMENT.search(_outside_quotes(match["rest"]))
        if comment and path not in comments:
            comments[path] = comment["words"].strip()
    return comments


def _outside_quotes(rest: str) -> str:
    """The rest of a line with each quoted string replaced by underscores: a # in a string begins no comment."""
    return re.sub(r"'[^']*'|\"[^\"]*\"", lambda quoted: "_" * len(quoted[0]), rest)


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
