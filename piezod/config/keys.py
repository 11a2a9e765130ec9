"""Keys of a bench file: their units, the JSON schema for editors, and the effective configuration with its defaults."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from piezod.config.bench import BenchConfig

_UNITS = {
    "V_per_s2": "V/s\N{SUPERSCRIPT TWO}",
    "V_per_s": "V/s",
    "N_per_s": "N/s",
    "us": "\N{MICRO SIGN}s",
    "degC": "\N{DEGREE SIGN}C",
    "seconds": "s",
    **{unit: unit for unit in ("Hz", "V", "N", "A", "F", "W", "s", "ms", "h", "MB", "samples")},
}


def unit_of(key: str) -> str:
    """The unit in the name of a key, such as V/s for `slew_V_per_s`; empty: no unit."""
    for suffix, unit in _UNITS.items():
        if key.endswith(f"_{suffix}"):
            return unit
    return ""


DIALECT = "https://json-schema.org/draft/2020-12/schema"


def bench_schema(comments: dict[str, str]) -> dict[str, Any]:
    """JSON schema (2020-12) of a bench file.

    Parameters
    ----------
    comments
        Comments by dotted path, from `comments_of`.

    Returns
    -------
    dict
        Types, ranges, choices and defaults. Conditions between keys are missing: only `load_bench` checks them.
    """
    schema = BenchConfig.model_json_schema(by_alias=True)
    definitions: dict[str, Any] = schema.get("$defs", {})
    _describe(schema, definitions, comments, "", set())
    return {"$schema": DIALECT, "title": "piezod bench"} | {k: v for k, v in schema.items() if k != "title"}


def _describe(
    node: dict[str, Any], definitions: dict[str, Any], comments: dict[str, str], path: str, seen: set[tuple[str, str]]
) -> None:
    """Write unit and comment into the description of each property, recursively."""
    for key, about in node.get("properties", {}).items():
        about.pop("title", None)
        dotted = f"{path}{key}"
        unit = unit_of(key)
        words = comments.get(dotted, "")
        if "description" not in about and (unit or words):
            about["description"] = f"[{unit}] {words}".strip() if unit else words
        for name in _references(about):
            if (name, dotted) not in seen:
                _describe(definitions[name], definitions, comments, f"{dotted}.", seen | {(name, dotted)})


def _references(node: object) -> list[str]:
    """Names of the definitions that a property refers to."""
    if isinstance(node, list):
        return [name for part in node for name in _references(part)]
    if not isinstance(node, dict):
        return []
    own = [str(node["$ref"]).rpartition("/")[2]] if "$ref" in node else []
    return own + [name for key in ("anyOf", "oneOf", "allOf", "items") for name in _references(node.get(key))]


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
