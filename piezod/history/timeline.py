"""Models of a bench in order, each compared with its parent, or with the model before it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezod.diagnose.findings import Value
from piezod.history.changes import EffectChange, ParameterChange, changes_between
from piezod.history.entries import ModelEntry, find_models, parent_of
from piezod.history.parameters import Key, assumed_intervals, assumed_words, parameters_of

SCHEMA = "piezod.history/1"


@dataclass(frozen=True)
class Step:
    """A model in a history.

    Parameters
    ----------
    reference
        Model that it is compared with: its parent, else the model before it; None: the first one.
    changes
        Status of every effect and of the base since the reference; empty without a reference.
    notes
        Remarks on the lineage of the model.
    """

    entry: ModelEntry
    reference: ModelEntry | None
    parameters: dict[Key, Value]
    changes: tuple[EffectChange, ...]
    notes: tuple[str, ...]

    def change_of(self, key: Key) -> ParameterChange | None:
        """Change of a parameter since the reference; None without a reference, or where both models lack it."""
        return next((known for effect in self.changes for known in effect.parameters if known.key == key), None)

    def is_marked(self, key: Key) -> bool:
        """Whether a parameter has changed since the reference."""
        change = self.change_of(key)
        return change is not None and change.changed


@dataclass(frozen=True)
class Timeline:
    """Models in order, a parent before its children, else by date."""

    steps: tuple[Step, ...]

    @classmethod
    def of(cls, entries: Sequence[ModelEntry]) -> "Timeline":
        """Timeline of models in order, as `find_models` returns them."""
        return cls(tuple(_step(entries, place) for place in range(len(entries))))

    @property
    def keys(self) -> list[Key]:
        """Parameters of all models, the base first."""
        return list(dict.fromkeys(key for step in self.steps for key in step.parameters))

    def unit_of(self, key: Key) -> str:
        """Unit of a parameter."""
        return next(step.parameters[key].unit for step in self.steps if key in step.parameters)

    def as_dict(self, verdict: str) -> dict[str, Any]:
        """The history for JSON, with its verdict in words."""
        return {
            "schema": SCHEMA,
            "verdict": verdict,
            "models": [_step_as_dict(step) for step in self.steps],
        }


def timeline_of(paths: Sequence[Path]) -> Timeline:
    """History of the models in files and folders; errors as for `find_models`."""
    return Timeline.of(find_models(paths))


def _step(entries: Sequence[ModelEntry], place: int) -> Step:
    entry = entries[place]
    parent = parent_of(entry, entries)
    reference = parent or (entries[place - 1] if place else None)
    parameters = parameters_of(entry.model)
    changes: tuple[EffectChange, ...] = ()
    if reference is not None:
        stated = entry.model.provenance.changes if parent is not None else ()
        changes = tuple(changes_between(parameters_of(reference.model), parameters, stated))
    return Step(entry, reference, parameters, changes, tuple(_notes(entry, parent, reference, parameters)))


def _notes(
    entry: ModelEntry, parent: ModelEntry | None, reference: ModelEntry | None, parameters: dict[Key, Value]
) -> list[str]:
    notes = list[str]()
    compared = "" if reference is None else "; compared with the model before it"
    if entry.parent is None and entry.model.effects:
        notes.append(f"states no parent, as in files of older versions{compared}")
    elif entry.parent is not None and parent is None:
        notes.append(f"its parent, SHA-256 {entry.parent[:12]}, is not among these files{compared}")
    elif entry.parent is None and reference is not None:
        notes.append(f"identified, without a parent{compared}")
    assumed = assumed_intervals(entry.model)
    if assumed:
        notes.append(assumed_words(assumed))
    exact = [str(key) for key, value in parameters.items() if value.low == value.high]
    return [*notes, f"states no interval of {', '.join(exact)}"] if exact else notes


def _step_as_dict(step: Step) -> dict[str, Any]:
    model, provenance = step.entry.model, step.entry.model.provenance
    return {
        "files": [str(path) for path in step.entry.paths],
        "sha256": sorted(step.entry.hashes),
        "name": model.name,
        "date": step.entry.date.isoformat(),
        "created": provenance.created,
        "parent": step.entry.parent,
        "compared_with": None if step.reference is None else str(step.reference.paths[0]),
        "recordings": [
            entry.model_dump(exclude_none=True) for entry in (*provenance.recordings, *provenance.diagnosed)
        ],
        "held_out_error": {"value": provenance.fit.rms_held_out, "unit": model.output.unit},
        "noise": {"value": None if model.information is None else model.information.noise, "unit": model.output.unit},
        "parameters": {
            str(key): value.as_dict() | {"changed": step.is_marked(key)} for key, value in step.parameters.items()
        },
        "changes": [change_as_dict(change) for change in step.changes],
        "notes": list(step.notes),
    }


def change_as_dict(change: EffectChange) -> dict[str, Any]:
    """Status of an effect for JSON."""
    return {
        "name": change.name,
        "status": change.status,
        "words": change.words,
        "parameters": {
            parameter.key.parameter: parameter.as_dict("before", "after") for parameter in change.parameters
        },
    }
