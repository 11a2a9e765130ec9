"""The catalogue of physical effects: one file each, and this registry, in the order of the signal chain."""

from piezod.effects import electrical_lag, resonance
from piezod.effects.effect import Context, Effect, Parameter, Seat, Values

EFFECTS: dict[str, Effect] = {module.EFFECT.name: module.EFFECT for module in (electrical_lag, resonance)}

__all__ = ["EFFECTS", "Context", "Effect", "Parameter", "Seat", "Values"]
