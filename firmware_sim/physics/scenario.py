"""A scenario: the physics of one emulated bench, read from `scenarios/NAME.yaml` or given as a mapping."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated

from pydantic import Field

from firmware_sim.errors import ConfigurationError
from firmware_sim.physics.effects import Effects, Finite, NotNegative, Positive, Section
from firmware_sim.yaml_reader import Document, Value, checked, read_document


class Amplifier(Section):
    """Output stage; a time constant or slew limit of 0 means none."""

    minimum_V: Finite = 0.0
    maximum_V: Positive = 140.0
    converter_step_V: NotNegative = 0.0
    time_constant_s: NotNegative = 0.0
    slew_V_per_s: NotNegative = 0.0
    readback_noise_V: NotNegative = 0.002


class Stack(Section):
    """Hysteresis: share of the irreversible part, and the scales of its two densities.

    `irreversible` is the irreversible share of the stroke on the virgin curve at `full_V`. `driven_to_V` is the highest
    voltage before power-on; the force is tared afterwards. 0: the stack is virgin.
    """

    full_V: Positive = 140.0
    irreversible: Annotated[float, Field(ge=0, lt=1)] = 0.42
    width_scale_V: Positive = 60.0
    bias_scale_V: Positive = 90.0
    driven_to_V: NotNegative = 0.0


class Mechanics(Section):
    """Force law at full stroke; see `mechanics.py`."""

    full_N: Positive = 300.0
    stiffening: Annotated[float, Field(ge=0, le=1)] = 0.08
    softening: Annotated[float, Field(ge=0, le=1)] = 0.3


class LoadCell(Section):
    """Rms of white and of coloured noise of a reading, step and range of the converter."""

    white_noise_N: NotNegative = 0.1
    coloured_noise_N: NotNegative = 0.0
    coloured_corner_Hz: Positive = 1.0
    converter_step_N: NotNegative = 0.0
    low_N: Finite = -500.0
    high_N: Finite = 1000.0


class Temperature(Section):
    """Temperature of the bench: mean, amplitude and period of its slow variation, and over-temperature limit."""

    mean_degC: Finite = 23.0
    wander_K: NotNegative = 1.0
    period_s: Positive = 45.0
    noise_K: NotNegative = 0.005
    trip_degC: Finite = 80.0


class Scenario(Section):
    """One emulated bench."""

    description: str = ""
    step_s: Annotated[float, Field(ge=1e-6, le=1e-2)] = 1e-4
    sample_rate_Hz: Annotated[float, Field(gt=0, le=1e6)] = 4000.0
    amplifier: Amplifier = Amplifier()
    stack: Stack = Stack()
    mechanics: Mechanics = Mechanics()
    load_cell: LoadCell = LoadCell()
    temperature: Temperature = Temperature()
    effects: Effects = Effects()


def scenario_names() -> list[str]:
    """Return the names of the scenarios of the package."""
    folder = resources.files("firmware_sim") / "scenarios"
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_scenario(name: str, overrides: Mapping[str, Value] | None = None) -> Scenario:
    """Read a scenario by name, or from a YAML file, with some of its values replaced.

    Parameters
    ----------
    name
        Name of a scenario, or path of a file that ends in .yaml or .yml.
    overrides
        Values to replace, by key; None: none.

    Raises
    ------
    ConfigurationError
        The scenario does not exist, or a value is invalid.
    """
    path = Path(name)
    if not name.endswith((".yaml", ".yml")):
        if name not in scenario_names():
            raise ConfigurationError(
                f"scenario is '{name}', must be one of {', '.join(scenario_names())}, or a YAML file"
            )
        path = Path(str(resources.files("firmware_sim") / "scenarios" / f"{name}.yaml"))
    document = read_document(path)
    return checked(Scenario, Document(document.name, _merged(document.content, overrides or {}), document.lines))


def with_effects(scenario: Scenario, names: tuple[str, ...]) -> Scenario:
    """Return the scenario with these effects on; an effect that was off gets its default strength.

    Parameters
    ----------
    scenario
        Physics of the bench.
    names
        Names of effects.

    Raises
    ------
    ConfigurationError
        A name is no effect of a scenario.
    """
    chosen = scenario.effects.model_dump(exclude_none=True)
    for name in names:
        if name not in Effects.model_fields:
            raise ConfigurationError(f"effect is '{name}', must be one of {', '.join(Effects.model_fields)}")
        chosen.setdefault(name, {})
    return scenario.model_copy(update={"effects": Effects.model_validate(chosen)})


def _merged(base: Mapping[str, Value], changes: Mapping[str, Value]) -> dict[str, Value]:
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        merged[key] = _merged(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return merged
