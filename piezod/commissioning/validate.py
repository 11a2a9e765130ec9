"""Compare models on the bench: six triangular force references, each without compensation and with every model."""

from dataclasses import dataclass
from pathlib import Path

from piezod.commissioning.demo import OnRows, follow_session
from piezod.config import BenchConfig
from piezod.config.reference import WaveformReference
from piezod.errors import ConfigurationError, UsageError
from piezod.model import Model, Plant
from piezod.recording import Recording
from piezod.session.assembly import Work, load_drivable, load_without_model
from piezod.session.session import Outcome, Session

# Parts of the forces that bench and models reach in common; the outermost stay 5 % inside it.
AMPLITUDES = (0.12, 0.24, 0.36)
OFFSETS = (0.41, 0.59)
FREQUENCY_HZ = 0.1  # static: rate dependence is another question
CYCLES = 3  # the first one comes from rest and does not close; the loops are judged on the others
WITHOUT = "without"


@dataclass(frozen=True)
class Validation:
    """What will be driven; nothing is energised yet.

    Parameters
    ----------
    bench, folder
        The bench, and the folder that its relative paths start from.
    range_N
        Forces that every model reaches within the bench's limits.
    references
        By name.
    works
        In the order they are driven, by (reference, compensation).
    """

    bench: BenchConfig
    folder: Path
    range_N: tuple[float, float]
    references: dict[str, WaveformReference]
    works: dict[tuple[str, str], Work]

    @property
    def compensations(self) -> list[str]:
        """`without`, then the models."""
        return list(dict.fromkeys(key[1] for key in self.works))

    @property
    def duration_s(self) -> float:
        """About how long it takes on the bench's clock [s]."""
        limits, arming = self.bench.limits, self.bench.arming
        span_V = limits.voltage_max_V - limits.voltage_safe_V
        around_s = 2 * span_V / arming.voltage_V_per_s + 0.25 * span_V * (
            1 / arming.voltage_V_per_s + 1 / limits.ramp_down_V_per_s
        )
        return len(self.works) * (CYCLES / FREQUENCY_HZ + around_s)


@dataclass(frozen=True)
class ValidationResult:
    """What was measured: the runs that reached their end, by (reference, compensation)."""

    recordings: dict[tuple[str, str], Recording]
    outcome: Outcome


def plan_validation(path: Path, model_paths: list[Path]) -> Validation:
    """Read bench and models and choose the references.

    Parameters
    ----------
    path
        Bench configuration; the model it names is not used.
    model_paths
        Models to compare; the first one also gives the plain gain that stands for no compensation.

    Raises
    ------
    ConfigurationError
        A file says something impossible, or the models reach no forces in common.
    UsageError
        A model is given twice.
    """
    bench = load_without_model(path)
    models = dict(zip(_labels(model_paths), [load_drivable(one) for one in model_paths], strict=True))
    range_N = common_range_N(bench, models)
    references = triangular_references(range_N)
    first = next(iter(models.values()))
    works = {}
    for name, reference in references.items():
        works[name, WITHOUT] = Work(f"{name}, {WITHOUT}", "gain", reference, model=first)
        for label, model in models.items():
            works[name, label] = Work(f"{name}, {label}", "inverse", reference, model=model)
    return Validation(bench, path.parent, range_N, references, works)


def common_range_N(bench: BenchConfig, models: dict[str, Model]) -> tuple[float, float]:
    """Forces that every model reaches on its steady major loop, within the bench's voltages and force limits [N].

    Raises
    ------
    ConfigurationError
        There are none.
    """
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
        bottom_N, top_N = Plant(model.model_copy(update={"input": driven})).steady_range()
        low_N, high_N = max(low_N, bottom_N), min(high_N, top_N)
    if low_N >= high_N:
        raise ConfigurationError(
            f"{', '.join(models)}: the highest force that all reach is {high_N:.4g} N, must be above the lowest, "
            f"{low_N:.4g} N; give models of the same bench"
        )
    return low_N, high_N


def triangular_references(range_N: tuple[float, float]) -> dict[str, WaveformReference]:
    """Three amplitudes about two offsets, as parts of `range_N`."""
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
    validation
        What `plan_validation` made.
    on_rows
        Called about ten times a second with what is new.

    Raises
    ------
    PiezodError
        The bench could not be had, or the session failed.
    """
    session = Session(validation.bench, None, validation.folder, list(validation.works.values()))
    history = follow_session(session, on_rows)
    recordings = {}
    for number, key in enumerate(validation.works):
        metadata = {"bench": validation.bench.name, "reference": key[0], "compensation": key[1]}
        recording = history.recording(number, metadata=metadata)
        if recording.time_s.size and recording.time_s[-1] > 0.95 * CYCLES / FREQUENCY_HZ:
            recordings[key] = recording
    return ValidationResult(recordings, session.outcome)


def _labels(paths: list[Path]) -> list[str]:
    """Short names of the model files; their paths where short ones would be the same."""
    stems = [path.stem for path in paths]
    if len({*stems, WITHOUT}) == len(paths) + 1:
        return stems
    if len({path.resolve() for path in paths}) < len(paths):
        raise UsageError(f"--model is {', '.join(map(str, paths))}: one stands twice, must be different files")
    return [str(path) for path in paths]
