"""What a bench file comes to: every key with its value, its unit, and whether it is a default."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from piezod.config.bench import BenchConfig
from piezod.config.units import unit_of

COLUMN = 44  # where the remarks stand


@dataclass(frozen=True)
class Entry:
    """One key: its path, its value, whether the file leaves it to its default, and whether it heads a section."""

    path: tuple[str, ...]
    value: Any
    default: bool
    section: bool


def dumped(bench: BenchConfig) -> dict[str, Any]:
    """Every key with its value as a file would have it, in the order of the readers."""
    return bench.model_dump(by_alias=True, mode="json")


def entries(values: dict[str, Any], content: dict[str, Any]) -> Iterator[Entry]:
    """Every key, section by section.

    Parameters
    ----------
    values
        As `dumped`.
    content
        What the file holds, to tell what it leaves out.
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
    """The whole configuration as YAML that can be read again, units and defaults in comments."""
    lines = []
    for entry in entries(values, content):
        indent = "  " * (len(entry.path) - 1)
        said = f"{indent}{entry.path[-1]}:" + ("" if entry.section else f" {_scalar(entry.value)}")
        remarks = [unit_of(entry.path[-1])] if not entry.section else []
        remarks += ["default"] if entry.default else []
        remark = ", ".join(one for one in remarks if one)
        lines.append(f"{said:{COLUMN}}# {remark}" if remark else said)
    return "\n".join(lines) + "\n"


def _scalar(value: object) -> str:
    """One value on one line."""
    if isinstance(value, str) and not value.isprintable():
        return json.dumps(value)
    text: str = yaml.safe_dump(value, default_flow_style=True, width=float("inf"), allow_unicode=True)
    return text.removesuffix("...\n").strip()
