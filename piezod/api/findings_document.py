"""Types of the content of `findings.json`, for programs that are checked by a type checker.

`piezod/diagnose/findings.py` makes the content and explains each value.
"""

from typing import NotRequired, TypedDict

from piezod.diagnose.findings import Status, Verdict


class ValueEntry(TypedDict):
    """Value of a parameter with the ends of its 95 % interval [unit]."""

    value: float
    unit: str
    low: float
    high: float


class ParameterEntry(ValueEntry):
    """Value of a parameter, and its value in the given model."""

    was: NotRequired[ValueEntry]


NoiseEntry = TypedDict(
    "NoiseEntry", {"value": float | None, "unit": str, "from": str | None, "at_most": NotRequired[float]}
)
"""Noise of the reading and its source; without a value it is unknown, and has an upper bound."""


class PlaceEntry(TypedDict):
    """Range on an axis, its share of the unexplained energy [1], and its p-value."""

    axis: str
    low: float
    high: float
    share: float
    p: float


class ErrorsEntry(TypedDict):
    """Rms errors on held-out data before and after [unit]."""

    before: float
    after: float
    unit: str


class RivalEntry(TypedDict):
    """Effect that explains nearly as much, its separation [noise rms], and the experiment that separates both."""

    name: str
    separation: float
    separate_by: str


class EffectEntry(TypedDict):
    """Effect that is new, changed or gone."""

    name: str
    status: Status
    confidence: float
    p_value: NotRequired[float]
    q_value: NotRequired[float]
    scope: str
    where: list[PlaceEntry]
    parameters: dict[str, ParameterEntry]
    held_out: ErrorsEntry
    rivals: list[RivalEntry]
    handling: str


class KeptEntry(TypedDict):
    """Effect of the given model without a detected change: whether it is shown, and its size as measured."""

    name: str
    parameters: dict[str, ValueEntry]
    seen: bool
    measured: dict[str, ValueEntry]


class BaseEntry(TypedDict):
    """Change of the stack itself: gain and width of the loops relative to the given model [1].

    `measured`: gain [output unit per input unit] and loop width [%] by the recordings alone.
    """

    status: str
    gain: ValueEntry | None
    loops: ValueEntry | None
    where: list[PlaceEntry]
    confidence: float
    measured: dict[str, ValueEntry]


class FitErrorsEntry(TypedDict):
    """Errors of the given and of the written model, and the noise [unit of the output]."""

    before: float
    after: float
    floor: float
    gap_closed: float | None


class HeldOutRecordingEntry(TypedDict):
    """Held-out recording with the errors of both models [unit of the output]."""

    path: str
    sha256: str
    before: float
    after: float


class PercentEntry(TypedDict):
    """Fit of the given and of the written model [%]."""

    before: float
    after: float


class FitEntry(TypedDict):
    """Errors of both models."""

    unit: str
    held_out: FitErrorsEntry
    held_out_recordings: list[HeldOutRecordingEntry]
    nrmse_percent: PercentEntry


class SizeEntry(TypedDict):
    """Size of an estimated input [unit]."""

    value: float
    unit: str


class UnrecordedEntry(TypedDict):
    """Input that is not recorded: its size, its form, and how long it keeps its value [s]."""

    size: SizeEntry
    form: str
    keeps_s: float


class UnexplainedEntry(TypedDict):
    """Structured share of the squared residual [1]."""

    explainable_share: float
    unrecorded_input: UnrecordedEntry | None


class ModeEntry(TypedDict):
    """Natural frequency [Hz] and damping ratio [1] of a mode."""

    frequency_Hz: float
    damping_ratio: float


class UnnamedLawEntry(TypedDict):
    """Law without a name: its drivers, memories [s], modes and errors."""

    drivers: list[str]
    form: str
    formula: str | None
    memories_s: list[float]
    modes: list[ModeEntry]
    scope: str
    held_out: ErrorsEntry
    p_value: float


class RecordingEntry(TypedDict):
    """Recording of the diagnosis, and the stretches that were left out [s]."""

    path: str
    sha256: str
    samples: int
    left_out_s: list[list[float]]


class FindingsDocument(TypedDict):
    """Content of `findings.json`, schema `piezod.findings/2`."""

    schema: str
    verdict: Verdict
    ended_early: bool
    words: str
    noise_floor: NoiseEntry
    where: list[PlaceEntry]
    effects: list[EffectEntry]
    kept: list[KeptEntry]
    base: BaseEntry
    fit: FitEntry
    unexplained: UnexplainedEntry
    unnamed_law: UnnamedLawEntry | None
    not_testable: list[str]
    notes: list[str]
    recordings: list[RecordingEntry]
