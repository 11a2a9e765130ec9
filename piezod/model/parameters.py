"""The parameters of a model: the sections of `model.yaml`.

A model stores the direct operator only. Its inverse is computed from it, so both always agree.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section
from piezod.effects import EFFECTS
from piezod.model.information import Information
from piezod.model.unnamed_law import UnnamedLaw
from piezod.operators import EPS, PrandtlIshlinskii
from piezod.recording.hold import Hold

Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
Interval = Annotated[tuple[float, float], Field(strict=False)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
BASE = "base"  # name of the stack itself among the changes of a model


class Channel(Section):
    """One measured quantity: its column in a recording, its unit, and its range in the recordings."""

    channel: Annotated[str, Field(min_length=1)]
    unit: Annotated[str, Field(min_length=1)]
    low: float
    high: float

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low is {self.low:g}, must be below high, {self.high:g}")
        return self


class Superposition(Section):
    """Weighted operators: their thresholds in the unit of the input, and their weights."""

    thresholds: Numbers
    weights: Numbers


class Hysteresis(Section):
    """Direct modified Prandtl-Ishlinskii operator; the weights of the dead zones have the unit output per input."""

    plays: Superposition
    dead_zones: Superposition
    offset: float = 0.0
    eps: Annotated[float, Field(gt=0, lt=1)] = EPS

    @property
    def stroke_per_V(self) -> float:
        """Sum of the weights of the plays [1]: stroke per volt where all of them move."""
        return float(sum(self.plays.weights))

    def operator(self) -> PrandtlIshlinskii:
        """Build the operator in its de-energised state.

        Raises
        ------
        ModelError
            The operator has no inverse.
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
    """Start state of a drive: de-energised, after a reset cycle 0 -> peak -> 0, or every state given."""

    kind: Literal["virgin", "reset", "states"] = "virgin"
    peak: float | None = None
    states: Numbers | None = None

    @model_validator(mode="after")
    def _fields_match_kind(self) -> Self:
        if (self.peak is None) == (self.kind == "reset"):
            raise ValueError("peak is given with kind reset only, and must be given there")
        if (self.states is None) == (self.kind == "states"):
            raise ValueError("states are given with kind states only, and must be given there")
        return self


class TextLayout(Section):
    """What the user said about a text file: names of its columns, rate, decimal mark, conversions."""

    columns: Annotated[tuple[str, ...], Field(strict=False)] = ()
    rate_Hz: Annotated[float, Field(gt=0)] | None = None
    decimal: Literal["", ".", ","] = ""
    scale: Annotated[tuple[str, ...], Field(strict=False)] = ()


class RecordingSource(Section):
    """Recording that a model was made from.

    `read_as` is how its text file had to be read, `span_s` its duration [s], and `date` the date that the file states.
    """

    path: str
    sha256: Sha256
    samples: Annotated[int, Field(ge=1)]
    span_s: Annotated[float, Field(ge=0)] | None = None
    date: str | None = None
    read_as: TextLayout | None = None


class FitFigures(Section):
    """Errors of a free-run simulation by the model, in the unit of the output, for fit and held-out data.

    `max_hysteresis` is the hysteresis of the output over the input. `remaining_hysteresis` is that of the output over
    the expected output: the hysteresis that remains with the inverse of this model.
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


class ModelChange(Section):
    """Status of an effect, or of the base, when a diagnosis wrote the model.

    `name` is that of the effect, or "base" for the stack itself. `words` state the reason.
    """

    name: Annotated[str, Field(min_length=1)]
    status: Literal["new", "changed", "gone", "kept", "not seen"]
    words: str


class Provenance(Section):
    """Origin of the model: time, program, recordings and errors of the fit.

    `recordings` are those of the identification, `diagnosed` those in which effects were found or compared.
    `parent` is the SHA-256 of the model file that a diagnosis started from, and `changes` are the differences from it.
    An identified model has no parent. Files of older versions state none of the three.
    """

    created: str
    by: str
    parent: Sha256 | None = None
    recordings: Annotated[tuple[RecordingSource, ...], Field(strict=False)] = ()
    diagnosed: Annotated[tuple[RecordingSource, ...], Field(strict=False)] = ()
    changes: Annotated[tuple[ModelChange, ...], Field(strict=False)] = ()
    fit: FitFigures = FitFigures()
    notes: str = ""


class EffectValues(Section):
    """Effect of the catalogue in a model, with the values of its parameters.

    An effect of a single recording (a tone, a load step) names its recording by SHA-256 and acts in no other.
    `since` is the SHA-256 of the first recording in which the effect was found, or "identification" where the
    recordings of the identification show it too. Without it this is unknown. `intervals` are the 95 %
    intervals of the parameters, as low and high.
    """

    name: Annotated[str, Field(min_length=1)]
    parameters: dict[str, float]
    intervals: dict[str, Interval] | None = None
    recording: Sha256 | None = None
    since: Annotated[str, Field(pattern=r"^(identification|[0-9a-f]{64})$")] | None = None

    @model_validator(mode="after")
    def _is_in_the_catalogue(self) -> Self:
        effect = EFFECTS.get(self.name)
        if effect is None:
            raise ValueError(f"name is '{self.name}', must be one of {', '.join(EFFECTS)}")
        for parameter in effect.parameters:
            value, low, high = self.parameters.get(parameter.name), parameter.low, parameter.high
            if value is None and parameter.optional:
                continue
            if value is None:
                raise ValueError(f"{self.name}: parameters has no {parameter.name}")
            if not low <= value <= high:
                raise ValueError(f"{self.name}: {parameter.name} is {value:g}, must be within {low:g} and {high:g}")
        named = {*self.parameters, *(self.intervals or {})}
        if unknown := named - {parameter.name for parameter in effect.parameters}:
            raise ValueError(f"{self.name}: has no parameter {', '.join(sorted(unknown))}")
        for name, (low, high) in (self.intervals or {}).items():
            if not low <= high:
                raise ValueError(f"{self.name}: interval of {name} is {low:g} to {high:g}, must not fall")
        return self


class Model(Section):
    """Content of a model file.

    `unnamed_law` is a law that a diagnosis fitted without a physical name.
    `sampling` is how the command runs between two samples, and `read_after` the time from a held command to its reading
    [samples]; see `piezod.recording.hold`. `seen_s` is the duration of the recording in which the effects were found
    [s]; the slope of a creep refers to it. `sample_s` is the sample period of that recording [s].
    """

    schema_: Annotated[Literal["piezod.model/1"], Field(alias="schema")] = "piezod.model/1"
    name: Annotated[str, Field(min_length=1, max_length=100)]
    input: Channel
    output: Channel
    hysteresis: Hysteresis
    effects: Annotated[tuple[EffectValues, ...], Field(strict=False)] = ()
    unnamed_law: UnnamedLaw | None = None
    sampling: Literal["straight", "held", "held_before"] = "straight"
    read_after: Annotated[float, Field(ge=0, le=1)] = 0.0
    seen_s: Annotated[float, Field(gt=0)] | None = None
    sample_s: Annotated[float, Field(gt=0)] | None = None
    start: Start = Start()
    provenance: Provenance
    information: Information | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_statistics(cls, content: object) -> object:
        """Older files have a section `statistics`, which is ignored."""
        return {key: content[key] for key in content if key != "statistics"} if isinstance(content, dict) else content

    @property
    def hold(self) -> Hold:
        """How the command runs between samples, as `sampling` and `read_after` state it."""
        return Hold(self.sampling, self.read_after if self.sampling == "held" else 0.0)

    def operator(self) -> PrandtlIshlinskii:
        """Build the operator in the model's start state.

        Raises
        ------
        ModelError
            The operator has no inverse, or no input leads to the start state.
        """
        operator = self.hysteresis.operator()
        if self.start.kind == "reset" and self.start.peak is not None:
            operator.reset(self.start.peak)
        elif self.start.states is not None:
            operator.set_states(self.start.states)
        return operator
