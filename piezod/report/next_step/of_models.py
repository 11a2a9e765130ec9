"""Next steps after commands on recordings and models, one function for each command."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from piezod.report.next_step import (
    AT_NOISE,
    BENCH,
    CLOSE,
    LATER,
    RESTING,
    STRUCTURED,
    NextStep,
    command,
    model_line,
    recorded_and_diagnosed,
)

if TYPE_CHECKING:
    from piezod.diagnose.findings import Findings


def after_identify(
    recordings: Sequence[Path],
    model: Path,
    *,
    useful: bool,
    noises: float | None,
    explained: float = 1.0,
    drives_a_bench: bool = True,
    refused: Iterable[str] = (),
) -> NextStep:
    """Whether the model is usable, and the next recording or run.

    Parameters
    ----------
    recordings, model
        Files of the identification.
    useful
        Whether the model explains more than half of the variance.
    noises
        Error on held-out data over the noise; None: the noise is unknown.
    explained
        Explained share of the variance on held-out data [1].
    drives_a_bench
        Whether the model leads from volts to newtons.
    refused
        Parts of the model that have no inverse.
    """
    folder = model.with_name(f"{model.stem}-diagnosis")
    diagnosis = command("diagnose", *recordings, "--model", model, "-o", folder)
    structured = noises > STRUCTURED if noises is not None else not drives_a_bench
    if not useful and structured:
        return NextStep("not usable yet; a diagnosis finds the dynamics that no hysteresis has", (diagnosis,))
    if not useful:
        repeat = (
            command("record", BENCH, "--excitation", "varying-triangles", "-o", "varying.csv"),
            command("identify", "varying.csv", "-o", model, "--force"),
        )
        return NextStep("not usable; record triangles over the whole range and identify again", repeat)
    left = "" if noises is None or noises < RESTING else f"the error is {noises:.2g} times the noise"
    if noises is None and explained < CLOSE:
        left = f"{100 * (1 - explained):.2g} % of the variance is not explained"
    if left:
        return NextStep(f"usable; {left}, a diagnosis tells why", (diagnosis,))
    later = command("diagnose", LATER, "--model", model, "-o", folder)
    if not drives_a_bench:
        return NextStep("usable; diagnose a later recording when the behaviour changes", (later,))
    if noises is None:
        record = recorded_and_diagnosed(model, folder, name="rich.csv")
        return NextStep("usable; these recordings do not show the noise, record a richer excitation", record)
    drive = (command("run", BENCH, "--arm"), *recorded_and_diagnosed(model, folder))
    words, lines = _with_refused("usable, at the noise; drive the bench with it", [model_line(model)], list(refused))
    return NextStep(f"{words}; record and diagnose again when it changes", drive, tuple(lines))


def after_simulate(recording: Path, model: Path, *, error: float | None, noise: float | None) -> NextStep:
    """Whether the model describes the recording.

    Parameters
    ----------
    error
        Standard deviation of measured minus simulated; None: without a measurement.
    noise
        Noise of the model's recordings; None: unknown. Both in the output's unit.
    """
    diagnosis = command("diagnose", recording, "--model", model, "-o", f"{recording.stem}-diagnosis")
    if error is None:
        return NextStep(
            "compare it with a measurement of the same command", (command("compare", LATER, "--model", model),)
        )
    if noise and error <= AT_NOISE * noise:
        return NextStep(f"nothing: the error is {error / noise:.2g} times the noise, the model describes the recording")
    words = "a diagnosis tells what is left"
    return NextStep(f"the error is {error / noise:.3g} times the noise; {words}" if noise else words, (diagnosis,))


def after_compare(measured: Path, best: Path, *, is_model: bool, error: float, noise: float | None) -> NextStep:
    """Use of the output that fits best.

    Parameters
    ----------
    best
        File of the best model or of the best simulated recording.
    error, noise
        Its rms error, and the noise; None: unknown [output unit].
    """
    if noise and error <= AT_NOISE * noise:
        keep = (model_line(best),) if is_model else ()
        return NextStep(f"use {best.name}: its error is {error / noise:.2g} times the noise", (), keep)
    if not is_model:
        words = "name the models themselves, so that a diagnosis can tell what is left"
        return NextStep(words, (command("compare", measured, "--model", "MODEL.yaml"),))
    diagnosis = command("diagnose", measured, "--model", best, "-o", f"{best.stem}-diagnosis")
    return NextStep(f"a diagnosis tells what {best.name} leaves", (diagnosis,))


def after_resid(recording: Path, model: Path, *, white: bool, independent: bool) -> NextStep:
    """Whether the residual still has structure.

    Parameters
    ----------
    white, independent
        Whether the residual is white, and whether it is independent of the input.
    """
    if white and independent:
        return NextStep("nothing: the model leaves only noise in this recording")
    diagnosis = command("diagnose", recording, "--model", model, "-o", f"{recording.stem}-diagnosis")
    if independent:
        return NextStep("a diagnosis tells coloured noise, which may remain, from an effect", (diagnosis,))
    return NextStep("the residual follows the input: a diagnosis names the effect", (diagnosis,))


def after_diagnose(
    findings: "Findings",
    recordings: Sequence[Path],
    model: Path,
    folder: Path,
    *,
    refused: Iterable[str] = (),
    bench: Path | None = None,
    drives_a_bench: bool = True,
) -> NextStep:
    """Which model to run with, which line the bench file needs, or which drive tells more.

    Parameters
    ----------
    model, folder
        Given model, and the folder of the result.
    refused
        Effects of the written model that have no inverse.
    bench
        Bench file; None: not named.
    drives_a_bench
        Whether the model leads from volts to newtons.
    """
    plan = _planned_drive(recordings, model, bench)
    if findings.verdict == "not_testable":
        little = "these recordings excite too little; record the drive that shows more"
        holds = "record a drive with three holds of half a second, which shows the noise"
        return NextStep(little if findings.noise_is_known else holds, plan)
    if findings.verdict == "unexplained" and findings.law is None:
        return NextStep("keep the given model; record the drive that shows more of the unknown effect", plan)
    changed = findings.effects or findings.base.changed or findings.law is not None
    if findings.verdict == "matches" or not changed:
        if not findings.not_testable:
            return NextStep("nothing: keep the given model")
        return NextStep("keep the given model; a richer drive would test the effects that these recordings hide", plan)
    written = folder / "model.yaml"
    if not drives_a_bench:
        later = command("simulate", LATER, "--model", written, "-o", "simulated.csv")
        return NextStep("use the written model", (later,))
    words, lines = _with_refused("drive with the written model", [model_line(written)], list(refused))
    run: tuple[str, ...] = (command("check", bench or BENCH), command("run", bench or BENCH, "--arm"))
    if bench is not None:  # its daemon runs, and does not change its model by itself
        run = (*(command(verb, bench) for verb in ("check", "disarm", "reload", "arm")),)
    if any(rival.separation < 1.0 for finding in findings.effects for rival in finding.rivals):
        words += "; to decide between an effect and its rival, record the planned drive"
        run = (*run, *plan)
    elif findings.verdict == "partly_explained":
        words += "; more is left, the planned drive shows more of it"
        run = (*run, *plan)
    return NextStep(words, run, tuple(lines))


def _with_refused(words: str, lines: list[str], without: Sequence[str]) -> tuple[str, list[str]]:
    """Advice and lines of the bench file, with what cannot be compensated."""
    if not without:
        return words, lines
    have = "has" if len(without) == 1 else "have"
    said = f"{words}; {' and '.join(without)} {have} no inverse and cannot be driven, so leave that out knowingly"
    return said, [*lines, f"compensation_without: [{', '.join(without)}]"]


def _planned_drive(recordings: Sequence[Path], model: Path, bench: Path | None) -> tuple[str, ...]:
    return (
        command("testable", *recordings, "--model", model, "--next", "next.csv"),
        command("record", bench or BENCH, "--excitation", "next.csv", "-o", "more.csv"),
        command("diagnose", *recordings, "more.csv", "--model", model, "-o", "diagnosis-more"),
    )


def after_testable(
    recordings: Sequence[Path], model: Path, next_file: Path | None, *, planned: bool, open_pairs: bool
) -> NextStep:
    """Whether another drive is needed.

    Parameters
    ----------
    next_file
        File for a planned drive; None: none was wanted.
    planned
        Whether that file was written.
    open_pairs
        Whether effects are left that the recordings do not separate.
    """
    diagnosis = command("diagnose", *recordings, "--model", model, "-o", "diagnosis")
    if next_file is not None and planned:
        drive = (
            command("record", BENCH, "--excitation", next_file, "-o", "more.csv"),
            command("diagnose", *recordings, "more.csv", "--model", model, "-o", "diagnosis"),
        )
        return NextStep("record the planned drive, then diagnose all recordings together", drive)
    if open_pairs and next_file is None:
        plan = command("testable", *recordings, "--model", model, "--next", "next.csv")
        return NextStep("plan the drive that separates the open pairs", (plan,))
    return NextStep("these recordings separate the effects: diagnose them", (diagnosis,))
