"""The catalogue of effects as text and JSON: a table of all effects, and a page for each."""

import difflib
from typing import Any

from piezod.effects import EFFECTS, Effect, Parameter
from piezod.errors import UsageError
from piezod.report.text_table import text_table


def effect_named(name: str) -> Effect:
    """Return an entry of the catalogue.

    Parameters
    ----------
    name
        Name of the effect, exactly as in the catalogue.

    Raises
    ------
    UsageError
        The catalogue has no effect of that name. The message gives the most similar name.
    """
    if name in EFFECTS:
        return EFFECTS[name]
    nearest = max(EFFECTS, key=lambda known: max(_similarity(name, part) for part in (known, *known.split("_"))))
    raise UsageError(
        f"no effect is named '{name}', the nearest is '{nearest}'; 'piezod effects' lists all {len(EFFECTS)}"
    )


def effects_table() -> str:
    """Format one line for each effect: name, location in the chain, handling by the compensator, parameters."""
    rows = [("effect", "location in the chain", "compensator", "parameters")]
    rows += [
        (effect.name, _location(effect), effect.handling, ", ".join(parameter.name for parameter in effect.catalogued))
        for effect in EFFECTS.values()
    ]
    return "\n".join(text_table(rows, left_aligned=4))


def effect_page(effect: Effect) -> str:
    """Format the documentation of an effect, its parameters with unit and range, and its handling."""
    rows = [("parameter", "unit", "range", "")]
    rows += [(p.name, p.unit, _range(p), "nuisance" if p.search.nuisance else "") for p in effect.parameters]
    table = "\n".join(text_table(rows, left_aligned=4))
    handling = effect.handling + (f": {effect.why}" if effect.why else "")
    return "\n\n".join(
        (
            f"{effect.name}: {effect.docstring.strip()}",
            table,
            f"Compensator: {handling}\nExperiment that distinguishes it: {effect.separate_by}",
        )
    )


def effect_as_dict(effect: Effect) -> dict[str, Any]:
    """Return an effect for JSON."""
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
                "name": parameter.name,
                "unit": parameter.unit,
                "low": parameter.low,
                "high": parameter.high,
                "choices": list(parameter.search.choices),
                "nuisance": parameter.search.nuisance,
                "place": parameter.instant,
            }
            for parameter in effect.parameters
        ],
        "docstring": effect.docstring.strip(),
    }


def _similarity(name: str, other: str) -> float:
    return difflib.SequenceMatcher(None, name, other).ratio()


def _location(effect: Effect) -> str:
    return effect.location.name.lower().replace("_", " ")


def _range(parameter: Parameter) -> str:
    if parameter.search.choices:
        return " or ".join(f"{choice:g}" for choice in parameter.search.choices)
    if parameter.instant:
        return "time in the recording"
    return f"{parameter.low:.4g} to {parameter.high:.4g}"
