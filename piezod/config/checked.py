"""Conversion of a YAML document into a frozen pydantic model, with an error message of one line."""

import difflib
from collections.abc import Iterable
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from piezod.config.yaml_reader import Document
from piezod.errors import ConfigurationError


class Section(BaseModel):
    """One mapping of a configuration file: immutable, no type conversion, no unknown keys, finite numbers only."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


SectionT = TypeVar("SectionT", bound=BaseModel)
Positive = Annotated[float, Field(gt=0)]

LONGEST_VALUE = 60  # characters of a value or key in a message
_LIMIT_WORDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_TYPE_WORDS = {
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "model_type": "a mapping",
    "dict_type": "a mapping",
}


def check(document: Document, section: type[SectionT]) -> SectionT:
    """Convert `document` into `section`.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit of the first error, and the number of further errors.
    """
    try:
        return section.model_validate(document.content)
    except ValidationError as error:
        details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise ConfigurationError(_explain(details[0], document, section) + more) from error


def require(holds: bool, name: str, value: float, limit: str) -> None:
    """Check a value against another key of its section.

    Parameters
    ----------
    holds
        Result of the comparison.
    name, value
        Key and value, for the message.
    limit
        Text after "must be", such as "at most slew_V_per_s, 400".

    Raises
    ------
    ValueError
        `holds` is false; pydantic turns it into an error of the section.
    """
    if not holds:
        raise ValueError(f"{name} is {value:g}, must be {limit}")


def _explain(detail: ErrorDetails, document: Document, section: type[BaseModel]) -> str:
    keys = [key for key in detail["loc"] if not _is_union_tag(key, document, detail["loc"])]
    where = f"{document.path}:{document.line_of([*keys, *_named_keys(detail)])}"
    name = _brief(".".join(str(key) for key in keys)) or "the file"
    value = shortened(detail["input"])
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in _LIMIT_WORDS:
        bound, words = _LIMIT_WORDS[kind]
        return f"{where}: {name} is {value}, must be {words} {context[bound]:g}"
    if kind in _TYPE_WORDS:
        return f"{where}: {name} is {value}, must be {_TYPE_WORDS[kind]}"
    match kind:
        case "missing":
            text = f"{name} is missing"
        case "extra_forbidden":
            text = f"unknown key {name}{_suggestion(str(keys[-1]), _known_keys(section))}"
        case "literal_error" | "enum":
            text = f"{name} is {value}, must be {context['expected']}"
        case "value_error":
            text = f"{name}: {context['error']}" if keys else str(context["error"])
        case "union_tag_invalid":
            text = f"{name}.kind is {shortened(context['tag'])}, must be one of {context['expected_tags']}"
        case "union_tag_not_found":
            text = f"{name}.kind is missing"
        case _:
            text = f"{name} is {value}: {detail['msg']}"
    return f"{where}: {text}"


def _named_keys(detail: ErrorDetails) -> list[str]:
    """Keys that begin the message of a section's own check, such as limits.force_trip_N; they are below its path."""
    message = str(detail.get("ctx", {}).get("error", "")) if detail["type"] == "value_error" else ""
    return message.partition(" ")[0].rstrip(":").split(".") if message else []


def _is_union_tag(key: str | int, document: Document, loc: tuple[str | int, ...]) -> bool:
    """Whether pydantic inserted `key` into the path as the kind of a union; the file has no such key."""
    node: Any = document.content
    for step in loc:
        if step == key and isinstance(node, dict) and step not in node and node.get("kind") == step:
            return True
        try:
            node = node[step]
        except (KeyError, IndexError, TypeError):
            continue
    return False


def _suggestion(key: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def _known_keys(section: type[BaseModel]) -> set[str]:
    """All keys that the file may contain, at any depth, for the suggestion in case of a misspelt key."""
    known: set[str] = set()
    definitions = section.model_json_schema()
    pending: list[Any] = [definitions]
    while pending:
        node = pending.pop()
        if isinstance(node, dict):
            known.update(node.get("properties", {}))
            pending.extend(node.values())
        elif isinstance(node, list):
            pending.extend(node)
    return known


def _brief(text: str) -> str:
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "..."


def shortened(value: object) -> str:
    """Text of a value for a message, at most 60 characters."""
    text = repr(value).replace("True", "true").replace("False", "false") if not isinstance(value, dict) else "a mapping"
    return _brief(text)
