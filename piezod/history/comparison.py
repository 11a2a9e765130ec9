"""Comparison of two models, parameter by parameter: two states of a stack, or two stacks of one type."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezod.diagnose.verdict.words import listed
from piezod.errors import UsageError
from piezod.history.changes import EffectChange, ParameterChange, changes_between, least_significant
from piezod.history.parameters import assumed_intervals, assumed_words, parameters_of
from piezod.model import Model, load_model

SCHEMA = "piezod.model_comparison/1"
SAME_RANGE = 1e-3  # relative difference of two driven ranges that counts as none


@dataclass(frozen=True)
class ModelComparison:
    """Two models with their differences.

    Parameters
    ----------
    driven
        Range of the input in which both stacks were driven; the figures of the base refer to it [input unit].
    changes
        Status of every effect and of the base in the second model.
    """

    paths: tuple[Path, Path]
    models: tuple[Model, Model]
    driven: tuple[float, float]
    changes: tuple[EffectChange, ...]
    notes: tuple[str, ...]

    @property
    def parameters(self) -> list[ParameterChange]:
        """Parameters of both models, the base first."""
        return [parameter for change in self.changes for parameter in change.parameters]

    @property
    def verdict(self) -> str:
        """Parameters that differ, in a sentence."""
        both = [parameter for parameter in self.parameters if parameter.before and parameter.after]
        different = [parameter.heading for parameter in both if parameter.changed]
        first, second = (path.name for path in self.paths)
        clauses = [f"{listed(different)} differ{'s' if len(different) == 1 else ''}"] if different else []
        for status, name in (("gone", first), ("new", second)):
            titles = [change.parameters[0].key.title for change in self.changes if change.status == status]
            clauses += [f"only {name} has {listed(titles)}"] if titles else []
        if not clauses:
            return f"no parameter differs beyond chance, of {len(both)} compared"
        rest = len(both) - len(different)
        return "; ".join([*clauses, f"{rest} of {len(both)} compared parameters agree"])

    def as_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        return {
            "schema": SCHEMA,
            "first": str(self.paths[0]),
            "second": str(self.paths[1]),
            "driven": {"low": self.driven[0], "high": self.driven[1], "unit": self.models[0].input.unit},
            "least_significant_z": least_significant(
                max(sum(parameter.z is not None for parameter in self.parameters), 1)
            ),
            "parameters": {str(parameter.key): parameter.as_dict("first", "second") for parameter in self.parameters},
            "effects": {change.name: change.status for change in self.changes},
            "verdict": self.verdict,
            "notes": list(self.notes),
        }


def compare_models(first: Path, second: Path) -> ModelComparison:
    """Compare two model files, parameter by parameter.

    Raises
    ------
    ConfigurationError, ModelError
        A file is no model.
    UsageError
        The models have different quantities, or no common range of the input.
    """
    models = load_model(first), load_model(second)
    quantities = [f"{model.input.unit} to {model.output.unit}" for model in models]
    if quantities[0] != quantities[1]:
        raise UsageError(f"{first} is of {quantities[0]}, {second} of {quantities[1]}: compare models of one kind")
    ranges = [(model.input.low, model.input.high) for model in models]
    driven = max(low for low, _ in ranges), min(high for _, high in ranges)
    if driven[0] >= driven[1]:
        raise UsageError(f"{first} and {second}: their inputs have no common range; record both over the same range")
    changes = changes_between(parameters_of(models[0], driven), parameters_of(models[1], driven))
    return ModelComparison((first, second), models, driven, tuple(changes), tuple(_notes(ranges, driven, models)))


def _notes(ranges: list[tuple[float, float]], driven: tuple[float, float], models: tuple[Model, Model]) -> list[str]:
    notes = []
    differ = max(abs(end - common) for pair in ranges for end, common in zip(pair, driven, strict=True))
    if differ > SAME_RANGE * (driven[1] - driven[0]):
        unit = models[0].input.unit
        notes.append(f"gain and loop width refer to the common range, {driven[0]:.4g} to {driven[1]:.4g} {unit}")
    assumed = dict.fromkeys(name for model in models for name in assumed_intervals(model))
    if assumed:
        notes.append(assumed_words(list(assumed)))
    once = sorted({effect.name for model in models for effect in model.effects if effect.recording is not None})
    if once:
        notes.append(f"effects of a single recording are not compared: {', '.join(once)}")
    return notes
