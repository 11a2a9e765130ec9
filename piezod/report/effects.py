"""The catalogue of effects in words: a table of all, a page of one, and the same as JSON."""

import difflib
from typing import Any

from piezod.effects import EFFECTS, Effect, Parameter
from piezod.errors import UsageError


def effect_named(name: str) -> Effect:
    """Entry of the catalogue.

    Raises
    ------
    UsageError
        There is none of that name; says the nearest.
    """
    if name in EFFECTS:
        return EFFECTS[name]
    nearest = max(EFFECTS, key=lambda one: max(_likeness(name, part) for part in (one, *one.split("_"))))
    raise UsageError(
        f"no effect is named '{name}', the nearest is '{nearest}'; 'piezod effects' lists all {len(EFFECTS)}"
    )


def effects_table() -> str:
    """One line an effect: name, location, parameters, what the compensator does about it."""
    rows = [("effect", "location", "compensator", "parameters")]
    rows += [
        (one.name, _location(one), one.handling, ", ".join(parameter.name for parameter in one.catalogued))
        for one in EFFECTS.values()
    ]
    return _columns(rows)


def effect_page(effect: Effect) -> str:
    """Its six fields, its parameters with unit and range, and what is done about it."""
    rows = [("parameter", "unit", "range", "")]
    rows += [(one.name, one.unit, _range(one), "nuisance" if one.search.nuisance else "") for one in effect.parameters]
    handling = effect.handling + (f": {effect.why}" if effect.why else "")
    return "\n\n".join(
        (
            f"{effect.name}: {effect.docstring.strip()}",
            _columns(rows),
            f"Compensator: {handling}\nTold apart by: {effect.separate_by}",
        )
    )


def effect_as_dict(effect: Effect) -> dict[str, Any]:
    """An effect for JSON."""
    return {
        "name": effect.name,
        "title": effect.title,
        "seat": _location(effect),
        "form": effect.form,
        "handling": effect.handling,
        "why": effect.why,
        "needs": effect.needs,
        "separate_by": effect.separate_by,
        "parameters": [
            {
                "name": one.name,
                "unit": one.unit,
                "low": one.low,
                "high": one.high,
                "choices": list(one.search.choices),
                "nuisance": one.search.nuisance,
                "place": one.instant,
            }
            for one in effect.parameters
        ],
        "docstring": effect.docstring.strip(),
    }


def _likeness(one: str, other: str) -> float:
    return difflib.SequenceMatcher(None, one, other).ratio()


def _location(effect: Effect) -> str:
    return effect.location.name.lower().replace("_", " ")


def _range(parameter: Parameter) -> str:
    if parameter.search.choices:
        return " or ".join(f"{choice:g}" for choice in parameter.search.choices)
    if parameter.instant:
        return "instant of the record"
    return f"{parameter.low:.4g} to {parameter.high:.4g}"


def _columns(rows: list[tuple[str, str, str, str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        "  ".join((*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[3])).rstrip()
        for row in rows
    )
