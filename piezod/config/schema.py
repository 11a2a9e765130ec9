"""The JSON schema of a bench file, for completion and checks in an editor, made from the readers themselves."""

from typing import Any

from piezod.config.bench import BenchConfig
from piezod.config.units import unit_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def bench_schema(comments: dict[str, str]) -> dict[str, Any]:
    """JSON schema (2020-12) of a bench file.

    Parameters
    ----------
    comments
        Words by dotted path, as `comments_of` reads them.

    Returns
    -------
    dict
        Types, ranges, choices and defaults are the readers'; what holds between keys only a check of the file tells.
    """
    schema = BenchConfig.model_json_schema(by_alias=True)
    definitions: dict[str, Any] = schema.get("$defs", {})
    _describe(schema, definitions, comments, "", set())
    return {"$schema": DIALECT, "title": "piezod bench"} | {k: v for k, v in schema.items() if k != "title"}


def _describe(
    node: dict[str, Any], definitions: dict[str, Any], comments: dict[str, str], path: str, seen: set[tuple[str, str]]
) -> None:
    """Put unit and comment beside every property, section by section."""
    for key, about in node.get("properties", {}).items():
        about.pop("title", None)
        here = f"{path}{key}"
        unit = unit_of(key)
        words = comments.get(here, "")
        if "description" not in about and (unit or words):
            about["description"] = f"[{unit}] {words}".strip() if unit else words
        for name in _references(about):
            if (name, here) not in seen:
                _describe(definitions[name], definitions, comments, f"{here}.", seen | {(name, here)})


def _references(node: object) -> list[str]:
    """Names of the definitions that a property leads to."""
    if isinstance(node, list):
        return [name for one in node for name in _references(one)]
    if not isinstance(node, dict):
        return []
    own = [str(node["$ref"]).rpartition("/")[2]] if "$ref" in node else []
    return own + [name for key in ("anyOf", "oneOf", "allOf", "items") for name in _references(node.get(key))]
