"""`piezod validate`: compare models on the bench.

The bench follows six triangular force references, each without compensation and with every model.
"""

from dataclasses import dataclass
from pathlib import Path

from piezod.config import BenchConfig
from piezod.config.reference import WaveformReference
from piezod.daemon.run import drive
from piezod.errors import ConfigurationError, UsageError
from piezod.model import Model, steady_range
from piezod.recording import Recording
from piezod.session.assembly import load_bench_without_model, load_drivable_model
from piezod.session.history import OnRows
from piezod.session.task import Outcome, SegmentSpec

AMPLITUDES = (0.12, 0.24, 0.36)
OFFSETS = (0.41, 0.59)  # parts of the common force range of bench and models; the peaks stay 5 % inside the range
FREQUENCY_HZ = 0.1  # frequency of the references [Hz]: quasi-static, without rate dependence
CYCLES = 3  # Number of cycles. The first begins at rest and its loop is not closed; the others are evaluated
WITHOUT = "without"


@dataclass(frozen=True)
class Validation:
    """Plan of a validation; nothing is energised yet.

    Parameters
    ----------
    bench, path
        Bench configuration and its file.
    range_N
        Lowest and highest force that every model reaches within the limits of the bench [N].
    segments
        Segments by (reference, compensation), in the order of driving.
    """

    bench: BenchConfig
    path: Path
    range_N: tuple[float, float]
    references: dict[str, WaveformReference]
    segments: dict[tuple[str, str], SegmentSpec]

    @property
    def compensations(self) -> list[str]:
        """Names of the compensations: `without`, then the models."""
        return list(dict.fromkeys(key[1] for key in self.segments))

    @property
    def duration_s(self) -> float:
        """Approximate duration on the clock of the bench [s]."""
        limits, arming = self.bench.limits, self.bench.arming
        span_V = limits.voltage_max_V - limits.voltage_safe_V
        reset_cycle_s = 2 * span_V / arming.voltage_V_per_s
        ramps_s = 0.25 * span_V * (1 / arming.voltage_V_per_s + 1 / limits.ramp_down_V_per_s)
        return len(self.segments) * (CYCLES / FREQUENCY_HZ + reset_cycle_s + ramps_s)


@dataclass(frozen=True)
class ValidationResult:
    """Measurements of a validation.

    Parameters
    ----------
    recordings
        Recordings by (reference, compensation), of the segments that reached their end.
    """

    recordings: dict[tuple[str, str], Recording]
    outcome: Outcome


def plan_validation(path: Path, model_paths: list[Path]) -> Validation:
    """Read bench and models, and choose the references.

    Parameters
    ----------
    path
        Bench configuration; the model that it names is not used.
    model_paths
        Model files to compare. The gain of the first one is used for "without compensation".

    Raises
    ------
    ConfigurationError
        A value is invalid, or the models have no common force range.
    UsageError
        A model is given twice.
    """
    bench = load_bench_without_model(path)
    models = dict(zip(_labels(model_paths), [load_drivable_model(path) for path in model_paths], strict=True))
    range_N = _common_range_N(bench, models)
    references = _triangular_references(range_N)
    first = next(iter(models.values()))
    segments = {}
    for name, reference in references.items():
        segments[name, WITHOUT] = SegmentSpec(f"{name}, {WITHOUT}", "gain", reference, model=first)
        for label, model in models.items():
            segments[name, label] = SegmentSpec(f"{name}, {label}", "inverse", reference, model=model)
    return Validation(bench, path, range_N, references, segments)


def _common_range_N(bench: BenchConfig, models: dict[str, Model]) -> tuple[float, float]:
    """Range of force that every model reaches on its major loop, within the limits of the bench [N]."""
    low_N, high_N = bench.limits.force_min_N, bench.limits.force_trip_N
    for label, model in models.items():
        low_V = max(model.input.low, bench.limits.voltage_min_V)
        high_V = min(model.input.high, bench.limits.voltage_max_V)
        if low_V >= high_V:
            raise ConfigurationError(
                f"{label}: was identified from {model.input.low:g} to {model.input.high:g} V, the bench drives "
                f"{bench.limits.voltage_min_V:g} to {bench.limits.voltage_max_V:g} V; must overlap"
            )
        driven = model.input.model_copy(update={"low": low_V, "high": high_V})
        bottom_N, top_N = steady_range(model.model_copy(update={"input": driven}))
        low_N, high_N = max(low_N, bottom_N), min(high_N, top_N)
    if low_N >= high_N:
        raise ConfigurationError(
            f"{', '.join(models)}: the highest force that all reach is {high_N:.4g} N, must be above the lowest, "
            f"{low_N:.4g} N; give models of the same bench"
        )
    return low_N, high_N


def _triangular_references(range_N: tuple[float, float]) -> dict[str, WaveformReference]:
    """References with three amplitudes about two offsets, by name; the range is from lowest to highest force [N]."""
    low_N, span_N = range_N[0], range_N[1] - range_N[0]
    references = {}
    for offset in OFFSETS:
        for amplitude in AMPLITUDES:
            amplitude_N, offset_N = round(amplitude * span_N, 1), round(low_N + offset * span_N, 1)
            references[f"{offset_N:g} +- {amplitude_N:g} N"] = WaveformReference(
                kind="triangle",
                amplitude_N=amplitude_N,
                offset_N=offset_N,
                frequency_Hz=FREQUENCY_HZ,
                duration_s=CYCLES / FREQUENCY_HZ,
            )
    return references


def run_validation(validation: Validation, on_rows: OnRows) -> ValidationResult:
    """Follow every reference with every compensation.

    Parameters
    ----------
    on_rows
        Called about ten times per second with new rows.

    Raises
    ------
    PiezodError
        The bench could not be connected, or the session failed.
    """
    segments = list(validation.segments.values())
    history, outcome = drive(validation.path, validation.bench, None, segments, on_rows)
    recordings = {}
    for number, key in enumerate(validation.segments):
        metadata = {"bench": validation.bench.name, "reference": key[0], "compensation": key[1]}
        recording = history.recording(number, metadata=metadata)
        if recording.time_s.size and recording.time_s[-1] > 0.95 * CYCLES / FREQUENCY_HZ:
            recordings[key] = recording
    return ValidationResult(recordings, outcome)


def _labels(paths: list[Path]) -> list[str]:
    """Names of the model files without folder and suffix; the paths if these names are not unique."""
    stems = [path.stem for path in paths]
    if len({*stems, WITHOUT}) == len(paths) + 1:
        return stems
    if len({path.resolve() for path in paths}) < len(paths):
        raise UsageError(f"--model is {', '.join(map(str, paths))}: one file stands twice, must be different files")
    return [str(path) for path in paths]
