"""`piezod run --sequence`: check a test sequence on a bench, then drive its steps."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from piezod.commissioning.check import check_bench
from piezod.commissioning.check_reference import check_reference
from piezod.commissioning.check_result import Check
from piezod.config import BenchConfig, model_path
from piezod.config.reference import FileReference
from piezod.config.sequence import SequenceStep, TestSequence, load_sequence
from piezod.control import ROW_DTYPE
from piezod.daemon.run import drive
from piezod.errors import CheckFailedError, ConfigurationError, PiezodError
from piezod.model import Model
from piezod.recording import Recording
from piezod.recording.ticks import GOOD
from piezod.session.assembly import load_bench_and_model, reference_table
from piezod.session.history import History, OnRows
from piezod.session.task import Outcome, SegmentSpec

OWN_REFERENCE = ("reference", "voltage", "preview")
"""Checks of the bench's own reference, which a sequence does not drive."""
RESULTS = ("junit.xml", "sequence.html")  # verdict and page, in the folder of the results
COMPLETE = 0.95  # share of a step's ticks that a complete step has at least: some exchanges may fail


@dataclass(frozen=True)
class SequencePlan:
    """A checked sequence; the bench is not energised yet.

    Parameters
    ----------
    bench, model, folder
        Bench, its model, and the folder of the bench file.
    variants
        Bench with the reference and the compensation of each step.
    ticks
        Length of each step [ticks].
    checks
        All checks, none of which failed.
    """

    bench: BenchConfig
    model: Model
    folder: Path
    sequence: TestSequence
    variants: tuple[BenchConfig, ...]
    ticks: tuple[int, ...]
    checks: list[Check]

    @property
    def duration_s(self) -> float:
        """Approximate duration [s]: references, reset cycles, approach and end."""
        limits, arming = self.bench.limits, self.bench.arming
        span_V = limits.voltage_max_V - limits.voltage_safe_V
        around_s = 2 * span_V / arming.voltage_V_per_s + span_V / limits.ramp_down_V_per_s
        return sum(self.ticks) / self.bench.rate_Hz + len(self.ticks) * around_s


@dataclass(frozen=True)
class StepRun:
    """Measurements of a step.

    Parameters
    ----------
    recording
        Reference, force and voltage while the reference was followed.
    complete
        Whether the reference reached its end.
    missed, failed_exchanges
        Counts over the whole step, with approach and ramp down.
    """

    recording: Recording
    complete: bool
    missed: int
    failed_exchanges: int


@dataclass(frozen=True)
class SequenceResult:
    """Runs of the steps, in their order, and the outcome of the session."""

    runs: list[StepRun]
    outcome: Outcome


def plan_sequence(config: Path, path: Path) -> SequencePlan:
    """Read a sequence, and check bench and steps; no voltage is written.

    Raises
    ------
    ConfigurationError, ModelError
        A file is invalid.
    CheckFailedError
        A check of the bench or of a step failed.
    """
    sequence = load_sequence(path)
    bench, model = load_bench_and_model(config)
    checks = [check for check in check_bench(config) if check.name not in OWN_REFERENCE]
    variants = tuple(_variant(bench, step, path.parent) for step in sequence.steps)
    for step, variant in zip(sequence.steps, variants, strict=True):
        checks += [
            Check(f"step '{step.name}', {check.name}", check.level, check.found, check.remedy)
            for check in _step_checks(variant, model, config.parent)
        ]
    failed = [check for check in checks if check.level == "FAIL"]
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise CheckFailedError(f"{path}: not driven, {failed[0].name}: {failed[0].found}{more}")
    ticks = tuple(len(reference_table(variant, config.parent)) for variant in variants)
    return SequencePlan(bench, model, config.parent, sequence, variants, ticks, checks)


def remove_results(output: Path) -> None:
    """Remove the results of an earlier run: they must not pass for the results of a run that was killed.

    Raises
    ------
    ConfigurationError
        A file cannot be removed.
    """
    for path in (*(output / name for name in RESULTS), *output.glob("step_[0-9]*.csv")):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be removed: {error.strerror}") from error


def _variant(bench: BenchConfig, step: SequenceStep, folder: Path) -> BenchConfig:
    """Bench with the reference of a step; a relative path starts from the folder of the sequence."""
    reference = step.reference
    if isinstance(reference, FileReference):
        reference = reference.model_copy(update={"path": str((folder / reference.path).resolve())})
    return bench.model_copy(update={"reference": reference, "compensation": step.compensation, "learning": None})


def _step_checks(bench: BenchConfig, model: Model, folder: Path) -> Iterator[Check]:
    """Checks of a step's reference; a force beyond the trips fails."""
    try:
        assert bench.reference_range is not None  # raises ValueError for a waveform beyond its bounds
        force_N = reference_table(bench, folder).values()
    except (PiezodError, ValueError) as error:
        yield Check("reference", "FAIL", str(error))
        return
    low_N, high_N = bench.limits.force_min_N, bench.limits.force_trip_N
    if force_N.min() <= low_N or force_N.max() >= high_N:
        span = f"{force_N.min():.6g} to {force_N.max():.6g} N, must be within limits.force_min_N and force_trip_N, "
        yield Check("reference", "FAIL", f"{span}{low_N:g} to {high_N:g} N")
        return
    yield from check_reference(bench, model, folder)


def run_sequence(plan: SequencePlan, config: Path, on_rows: OnRows) -> SequenceResult:
    """Drive the steps of a checked sequence; a fault or Ctrl-C ends it.

    Parameters
    ----------
    config
        Bench configuration, for the metadata.
    on_rows
        Called about ten times per second with new rows.

    Raises
    ------
    PiezodError
        The bench could not be connected, or the session failed.
    """
    specs = [
        SegmentSpec(step.name, step.compensation, variant.reference)
        for step, variant in zip(plan.sequence.steps, plan.variants, strict=True)
    ]
    history, outcome = drive(config, plan.bench, plan.model, specs, on_rows)
    model = str(model_path(plan.bench, config))
    about = {"bench": plan.bench.name, "model": model, "sequence": plan.sequence.name}
    return SequenceResult([_step_run(plan, history, k, about) for k in range(len(specs))], outcome)


def _step_run(plan: SequencePlan, history: History, number: int, about: dict[str, str]) -> StepRun:
    recording = history.recording(number, metadata=about | {"step": plan.sequence.steps[number].name})
    rows = history.rows
    assert rows.dtype == ROW_DTYPE
    rows = rows[rows["segment"] == number]
    due = int(rows["tick"][-1] - rows["tick"][0]) + 1 if rows.size else 0
    return StepRun(
        recording=recording,
        complete=recording.time_s.size >= COMPLETE * plan.ticks[number],
        missed=due - int(rows.size),
        failed_exchanges=int((rows["result"] != GOOD).sum()),
    )
