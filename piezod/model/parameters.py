"""`model.yaml`: what identification knows about a bench, and the one thing that passes from recordings to the tick.

Only the direct operator is stored; its inverse is computed from it, so the two can never disagree. Reading a file and
writing it again gives the same text.
"""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import yaml
from pydantic import Field, model_validator

from piezod.config import Section, check, read_document, shortened
from piezod.effects import EFFECTS
from piezod.errors import ConfigurationError, ModelError
from piezod.operators import EPS, PrandtlIshlinskii
from piezod.recording.hold import Hold

SCHEMA = "piezod.model/1"

Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]


class Channel(Section):
    """One measured quantity: its column in a recording, its unit, and the range that was seen."""

    channel: Annotated[str, Field(min_length=1)]
    unit: Annotated[str, Field(min_length=1)]
    low: float
    high: float

    @model_validator(mode="after")
    def _range_is_one(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low is {self.low:g}, must be below high, {self.high:g}")
        return self


class Superposition(Section):
    """Weighted operators: thresholds in the input's unit and their weights."""

    thresholds: Numbers
    weights: Numbers


class Hysteresis(Section):
    """The direct modified Prandtl-Ishlinskii operator; weights of the dead zones in output unit per input unit."""

    plays: Superposition
    dead_zones: Superposition
    offset: float = 0.0
    eps: Annotated[float, Field(gt=0, lt=1)] = EPS

    def operator(self) -> PrandtlIshlinskii:
        """Build the operator, de-energised.

        Raises
        ------
        ModelError
            It has no inverse.
        """
        return PrandtlIshlinskii(
            self.plays.thresholds,
            self.plays.weights,
            self.dead_zones.thresholds,
            self.dead_zones.weights,
            offset=self.offset,
            eps=self.eps,
        )


class Start(Section):
    """The states a drive starts from: de-energised, after a reset cycle 0 -> peak -> 0, or given one by one."""

    kind: Literal["virgin", "reset", "states"] = "virgin"
    peak: float | None = None
    states: Numbers | None = None

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Self:
        if (self.peak is None) == (self.kind == "reset"):
            raise ValueError("peak belongs to kind reset, and to no other")
        if (self.states is None) == (self.kind == "states"):
            raise ValueError("states belong to kind states, and to no other")
        return self


class RecordingSource(Section):
    """A recording the model was identified on."""

    path: str
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    samples: Annotated[int, Field(ge=1)]


class FitFigures(Section):
    """How well the model simulates in free run, in the output's unit, fit and held-out data apart.

    Max hysteresis is that of the output over the input, the remaining one that of the output over what the model
    expects: what an inverse of this model would leave.
    """

    rms_fit: float | None = None
    rms_held_out: float | None = None
    max_fit: float | None = None
    max_held_out: float | None = None
    nrmse_percent_fit: float | None = None
    nrmse_percent_held_out: float | None = None
    max_hysteresis_percent_fit: float | None = None
    max_hysteresis_percent_held_out: float | None = None
    remaining_hysteresis_percent_fit: float | None = None
    remaining_hysteresis_percent_held_out: float | None = None


class Statistics(Section):
    """Sufficient statistics of the fit: its squared error near the solution, without the samples.

        e'e(p) = samples rms^2 + (p - p0)' N (p - p0),   p = [play slopes, constant, dead-zone slopes]

    Slopes are partial sums of weights; the constant is added to the plays' output, in front of dead zones that begin at
    `zone_thresholds` and at the output `origin`. `normal` is the lower triangle of N, row by row [output unit^2].
    """

    samples: Annotated[int, Field(ge=1)]
    rms: Annotated[float, Field(ge=0)]
    play_slopes: Numbers
    constant: float
    zone_thresholds: Numbers
    zone_slopes: Numbers
    origin: float
    normal: Numbers

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        size = len(self.play_slopes) + 1 + len(self.zone_slopes)
        if len(self.normal) != size * (size + 1) // 2:
            raise ValueError(f"normal has {len(self.normal)} numbers, must have {size * (size + 1) // 2}")
        return self


class Provenance(Section):
    """Where the model comes from."""

    created: str
    by: str
    recordings: Annotated[tuple[RecordingSource, ...], Field(strict=False)] = ()
    fit: FitFigures = FitFigures()
    notes: str = ""


class EffectValues(Section):
    """An effect of the catalogue that the model has besides its hysteresis, with the values of its parameters.

    One that belongs to a single recording (a tone, a load step) names it by its SHA-256, and acts in no other.
    """

    name: Annotated[str, Field(min_length=1)]
    parameters: dict[str, float]
    recording: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None

    @model_validator(mode="after")
    def _is_in_the_catalogue(self) -> Self:
        effect = EFFECTS.get(self.name)
        if effect is None:
            raise ValueError(f"name is '{self.name}', must be one of {', '.join(EFFECTS)}")
        for one in effect.parameters:
            value = self.parameters.get(one.name)
            if value is None and one.optional:
                continue
            if value is None:
                raise ValueError(f"{self.name}: parameters has no {one.name}")
            if not one.low <= value <= one.high:
                raise ValueError(f"{self.name}: {one.name} is {value:g}, must be within {one.low:g} and {one.high:g}")
        if unknown := set(self.parameters) - {one.name for one in effect.parameters}:
            raise ValueError(f"{self.name}: has no parameter {', '.join(sorted(unknown))}")
        return self


class Model(Section):
    """A whole model file.

    `sampling` says how the command runs between two samples and when the reading is taken: straight; held, and read
    `read_after` parts of a sample after it; or held, and read just before the next one. `seen_s` is how long the
    recording lasted that the effects were found in [s]: the slope of a creep refers to it;
    `sample_s` is the spacing of its samples [s], which `sampling` refers to.
    """

    schema_: Annotated[Literal["piezod.model/1"], Field(alias="schema")] = "piezod.model/1"
    name: Annotated[str, Field(min_length=1, max_length=100)]
    input: Channel
    output: Channel
    hysteresis: Hysteresis
    effects: Annotated[tuple[EffectValues, ...], Field(strict=False)] = ()
    sampling: Literal["straight", "held", "held_before"] = "straight"
    read_after: Annotated[float, Field(ge=0, le=1)] = 0.0
    seen_s: Annotated[float, Field(gt=0)] | None = None
    sample_s: Annotated[float, Field(gt=0)] | None = None
    start: Start = Start()
    provenance: Provenance
    statistics: Statistics | None = None

    @property
    def hold(self) -> Hold:
        """How the command runs between samples, as `sampling` and `read_after` state it."""
        return Hold(self.sampling, self.read_after if self.sampling == "held" else 0.0)

    def operator(self) -> PrandtlIshlinskii:
        """Build the operator in the model's start state.

        Raises
        ------
        ModelError
            It has no inverse, or no input leads to the start state.
        """
        operator = self.hysteresis.operator()
        if self.start.kind == "reset" and self.start.peak is not None:
            operator.reset(self.start.peak)
        elif self.start.states is not None:
            operator.set_states(self.start.states)
        return operator


def load_model(path: Path) -> Model:
    """Read, check and try a model.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit.
    ModelError
        The schema is another one, or the model has no inverse.
    """
    document = read_document(path)
    schema = document.content.get("schema")
    if schema != SCHEMA:
        raise ModelError(f"{path}: schema is {shortened(schema)}, must be '{SCHEMA}'; identify again with this version")
    model = check(document, Model)
    try:
        model.operator()
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    return model


def dump_model(model: Model) -> str:
    """Text of the model file."""
    content = model.model_dump(by_alias=True, exclude_none=True)
    if not model.effects:
        del content["effects"]
    if model.sampling == "straight":
        del content["sampling"]
    if model.sampling != "held":
        del content["read_after"]
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def save_model(model: Model, path: Path) -> None:
    """Write the model, whole or not at all.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(dump_model(model), encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, as provenance keeps it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Dumper(yaml.SafeDumper):
    """Lists of numbers in one line, floats so that they read back to the same bits."""


def _represent_list(dumper: yaml.SafeDumper, values: Sequence[object]) -> yaml.Node:
    flow = all(isinstance(value, (int, float)) for value in values) and bool(values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    return dumper.represent_scalar(
        "tag:yaml.org,2002:float",
        np.format_float_scientific(value, trim="0", exp_digits=1)
        if value != 0 and not 1e-4 <= abs(value) < 1e16
        else repr(value),
    )


_Dumper.add_representer(tuple, _represent_list)
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(float, _represent_float)
