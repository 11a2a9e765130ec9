"""The JSON schema of a bench file for editors, generated from the pydantic models."""

from typing import Any

from piezod.config.bench import BenchConfig
from piezod.config.units import unit_of

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
