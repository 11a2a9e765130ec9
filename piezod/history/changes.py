"""Changes from one model to another: effect by effect, and parameter by parameter with its significance."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

from piezod.diagnose.findings import Value
from piezod.history.parameters import Key
from piezod.model.parameters import BASE, ModelChange

FALSE_ALARM = 0.05  # probability that any parameter of two equal stacks counts as changed
HALF_95 = NormalDist().inv_cdf(0.975)  # half of a 95 % interval [standard errors]
EQUAL = 1e-6  # relative difference of two values without interval that counts as none


@dataclass(frozen=True)
class ParameterChange:
    """A parameter in two models.

    Parameters
    ----------
    before, after
        Values; None: the model lacks the effect.
    z
        Difference over its standard error; None: one is missing, or neither has an interval.
    changed
        Whether the difference counts.
    """

    key: Key
    before: Value | None
    after: Value | None
    z: float | None
    changed: bool

    def as_dict(self, before: str, after: str) -> dict[str, Any]:
        """The change for JSON, with the names of both values."""
        values = {before: self.before, after: self.after}
        shown = {name: None if value is None else value.as_dict() for name, value in values.items()}
        return {**shown, "z": self.z, "changed": self.changed}

    @property
    def heading(self) -> str:
        """Name of the effect and of the parameter."""
        value = self.after or self.before
        assert value is not None
        return self.key.heading(value.unit)


@dataclass(frozen=True)
class EffectChange:
    """An effect, or the base, in two models.

    Parameters
    ----------
    name
        Name in the catalogue, or "base".
    status
        "new", "changed", "gone" or "kept".
    parameters
        Its parameters; empty for an effect that the models do not hold.
    words
        Reason as the diagnosis states it; empty: it states none.
    """

    name: str
    status: str
    parameters: tuple[ParameterChange, ...]
    words: str = ""


def changes_between(
    before: Mapping[Key, Value], after: Mapping[Key, Value], stated: Sequence[ModelChange] = ()
) -> list[EffectChange]:
    """Status of every effect, the base first.

    Parameters
    ----------
    before, after
        Parameters of both models.
    stated
        Status of the effects as a diagnosis states it. Without it, a parameter has changed if its difference is
        significant, family-wise over all parameters of both models.
    """
    pairs = {key: (before.get(key), after.get(key)) for key in (*before, *after)}
    both = sum(None not in pair for pair in pairs.values())
    limit = least_significant(max(both, 1))
    by_name = {change.name: change for change in stated}
    names = dict.fromkeys((BASE, *(key.effect for key in pairs), *by_name))
    return [
        _effect_change(name, {key: pair for key, pair in pairs.items() if key.effect == name}, limit, by_name.get(name))
        for name in names
    ]


def least_significant(parameters: int) -> float:
    """Smallest magnitude of z that counts among so many parameters (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / parameters)


def z_of(before: Value, after: Value) -> float | None:
    """Difference over its standard error, from the sides of the intervals that face each other; None: no interval."""
    rises = after.value >= before.value
    first = before.high - before.value if rises else before.value - before.low
    second = after.value - after.low if rises else after.high - after.value
    error = math.hypot(first, second) / HALF_95
    return (after.value - before.value) / error if error > 0.0 else None


def _effect_change(
    name: str,
    pairs: Mapping[Key, tuple[Value | None, Value | None]],
    limit: float,
    stated: ModelChange | None,
) -> EffectChange:
    compared = [_compared(key, *pair, limit) for key, pair in pairs.items()]
    if stated is not None:
        status = {"not seen": "kept"}.get(stated.status, stated.status)
        return EffectChange(name, status, tuple(_as_stated(compared, status)), stated.words)
    if compared and all(change.before is None for change in compared):
        status = "new"
    elif compared and all(change.after is None for change in compared):
        status = "gone"
    else:
        status = "changed" if any(change.changed for change in compared) else "kept"
    return EffectChange(name, status, tuple(compared))


def _compared(key: Key, before: Value | None, after: Value | None, limit: float) -> ParameterChange:
    if before is None or after is None:
        return ParameterChange(key, before, after, None, changed=True)
    z = z_of(before, after)
    if z is None:
        differs = abs(after.value - before.value) > EQUAL * max(abs(before.value), abs(after.value))
        return ParameterChange(key, before, after, None, changed=differs)
    return ParameterChange(key, before, after, z, changed=abs(z) > limit)


def _as_stated(compared: Sequence[ParameterChange], status: str) -> list[ParameterChange]:
    """Changes that agree with the stated status: a changed effect has at least one changed parameter."""
    if status == "kept":
        return [replace(change, changed=False) for change in compared]
    if status != "changed" or not compared or any(change.changed for change in compared):
        return list(compared)
    largest = max(compared, key=lambda change: abs(change.z or 0.0))
    return [replace(change, changed=change is largest) for change in compared]
