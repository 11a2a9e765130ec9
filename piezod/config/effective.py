"""The effective configuration: each key with its value, its unit, and whether the value is a default."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from piezod.config.bench import BenchConfig
from piezod.config.units import unit_of

COLUMN = 44  # column of unit and "default"


@dataclass(frozen=True)
class Entry:
    """One key: path, value, whether the value is the default, and whether the key opens a section."""

    path: tuple[str, ...]
    value: Any
    default: bool
    section: bool


def all_values(bench: BenchConfig) -> dict[str, Any]:
    """All keys and values as in a file, in the order of the pydantic models."""
    return bench.model_dump(by_alias=True, mode="json")


def entries(values: dict[str, Any], content: dict[str, Any]) -> Iterator[Entry]:
    """All keys, section by section.

    Parameters
    ----------
    values
        Result of `all_values`.
    content
        Content of the file; keys that it omits are marked as default.
    """
    return _entries(values, content, ())


def _entries(values: dict[str, Any], content: object, above: tuple[str, ...]) -> Iterator[Entry]:
    for key, value in values.items():
        given = content.get(key) if isinstance(content, dict) else None
        default = not (isinstance(content, dict) and key in content)
        if isinstance(value, dict):
            yield Entry((*above, key), value, default, section=True)
            yield from _entries(value, given, (*above, key))
        else:
            yield Entry((*above, key), value, default, section=False)


def effective_text(values: dict[str, Any], content: dict[str, Any]) -> str:
    """The whole configuration as valid YAML, with units and defaults in comments."""
    lines = []
    for entry in entries(values, content):
        indent = "  " * (len(entry.path) - 1)
        line = f"{indent}{entry.path[-1]}:" + ("" if entry.section else f" {_scalar(entry.value)}")
        remarks = [unit_of(entry.path[-1])] if not entry.section else []
        remarks += ["default"] if entry.default else []
        remark = ", ".join(text for text in remarks if text)
        lines.append(f"{line:{COLUMN}}# {remark}" if remark else line)
    return "\n".join(lines) + "\n"


def _scalar(value: object) -> str:
    """A value as YAML on one line."""
    if isinstance(value, str) and not value.isprintable():
        return json.dumps(value)
    text: str = yaml.safe_dump(value, default_flow_style=True, width=float("inf"), allow_unicode=True)
    return text.removesuffix("...\n").strip()
