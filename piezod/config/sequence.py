"""A test sequence: references to follow one after the other, each with the limits of its verdict."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section, check, require, shortened
from piezod.config.reference import FileReference, WaveformReference, is_looped
from piezod.config.yaml_reader import read_document
from piezod.errors import ConfigurationError

SCHEMA = "piezod.sequence/1"
MOST_STEPS = 200

NotNegative = Annotated[float, Field(ge=0)]


class StepLimits(Section):
    """Limits of a step; null: not checked. A step needs at least one.

    `max_hysteresis_percent` is computed without the first period, which starts from rest.
    """

    rms_error_N: NotNegative | None = None
    max_error_N: NotNegative | None = None
    max_hysteresis_percent: NotNegative | None = None
    lowest_force_N: float | None = None
    highest_force_N: float | None = None
    missed_ticks: Annotated[int, Field(ge=0)] | None = None
    failed_exchanges: Annotated[int, Field(ge=0)] | None = None

    @property
    def given(self) -> dict[str, float]:
        """Limits that are given, by key."""
        return {name: value for name, value in self.model_dump().items() if value is not None}

    @model_validator(mode="after")
    def _one_limit_is_given(self) -> Self:
        if not self.given:
            raise ValueError(f"no limit is given, must be at least one of {', '.join(type(self).model_fields)}")
        low_N, high_N = self.lowest_force_N, self.highest_force_N
        if low_N is not None and high_N is not None:
            require(low_N < high_N, "lowest_force_N", low_N, f"below highest_force_N, {high_N:g}")
        return self


class SequenceStep(Section):
    """A reference with an end, its compensation, and its limits."""

    name: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f]+$")]
    reference: Annotated[WaveformReference | FileReference, Field(discriminator="kind")]
    compensation: Literal["inverse", "gain"] = "inverse"
    limits: StepLimits

    @model_validator(mode="after")
    def _the_reference_ends(self) -> Self:
        if is_looped(self.reference):
            remedy = "loop: false" if isinstance(self.reference, FileReference) else "duration_s"
            raise ValueError(f"reference repeats without end, must end; give {remedy}")
        hysteresis = self.limits.max_hysteresis_percent is not None
        if hysteresis and not (
            isinstance(self.reference, WaveformReference) and self.reference.kind in ("triangle", "sine")
        ):
            raise ValueError("limits.max_hysteresis_percent needs a reference of kind triangle or sine")
        return self


class TestSequence(Section):
    """Steps of a test, in the order of driving."""

    __test__ = False  # no class of tests

    schema_: Annotated[Literal["piezod.sequence/1"], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    steps: Annotated[tuple[SequenceStep, ...], Field(strict=False, min_length=1, max_length=MOST_STEPS)]

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [step.name for step in self.steps]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"steps: the name {twice[0]!r} stands twice, must differ")
        return self


def load_sequence(path: Path) -> TestSequence:
    """Read and check a test sequence.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit.
    """
    document = read_document(path, SCHEMA.encode())
    schema = document.content.get("schema")
    if schema != SCHEMA:
        raise ConfigurationError(f"{path}: schema is {shortened(schema)}, must be '{SCHEMA}'")
    return check(document, TestSequence)
