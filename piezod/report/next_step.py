"""The next step after each command, with the lines to paste.

One function for each command. A file that the user does not have yet is in capitals, as in the help: BENCH.yaml.
"""

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from piezod.diagnose.findings import Findings

BENCH, LATER = Path("BENCH.yaml"), Path("LATER.csv")
AT_NOISE = 1.3
"""Error, in multiples of the noise, that counts as noise: `diagnose.findings.ABOVE_NOISE`."""
RESTING = 1.1
"""The same for held-out data of an identification: `identify.identification.AT_THE_NOISE`."""
STRUCTURED = 3.0
"""Error of a useless model, in multiples of the noise, above which it has structure: as in `identify`."""
CLOSE = 0.99
"""Explained share of the variance below which a static model lacks more than noise: identified stacks reach 0.999."""
RICH = "staircase-minor-loops-multisine"
"""Excitation that shows most effects: rests, minor loops, and many rates."""


@dataclass(frozen=True)
class NextStep:
    """Next step after a command.

    Parameters
    ----------
    words
        Action and reason, in a sentence without a full stop.
    commands
        Commands to paste, in order.
    bench_lines
        Lines for the bench file, which come before the commands.
    """

    words: str
    commands: tuple[str, ...] = ()
    bench_lines: tuple[str, ...] = ()

    def text(self) -> str:
        """Lines for a terminal."""
        lines = [f"next: {self.words}"]
        if self.bench_lines:
            lines += ["  in the bench file:", *(f"    {line}" for line in self.bench_lines)]
        return "\n".join([*lines, *(f"    {command}" for command in self.commands)])

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"words": self.words, "commands": list(self.commands), "bench_lines": list(self.bench_lines)}


def command(*words: object) -> str:
    """A command line of piezod, quoted for a shell.

    Parameters
    ----------
    words
        Arguments after `piezod`.
    """
    return shlex.join(["piezod", *map(str, words)])


def model_line(model: Path) -> str:
    """Line of a bench file that names a model, valid in every folder."""
    return f"model: {model.resolve()}"


def after_identify(
    recordings: Sequence[Path],
    model: Path,
    *,
    useful: bool,
    noises: float | None,
    explained: float = 1.0,
    drives_a_bench: bool = True,
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
        record = (
            command("record", BENCH, "--excitation", RICH, "-o", "rich.csv"),
            command("diagnose", "rich.csv", "--model", model, "-o", folder),
        )
        return NextStep("usable; these recordings do not show the noise, record a richer excitation", record)
    drive = (
        command("run", BENCH, "--arm"),
        command("record", BENCH, "--excitation", RICH, "-o", "later.csv"),
        command("diagnose", "later.csv", "--model", model, "-o", folder),
    )
    words = "usable, at the noise; drive the bench with it, and record and diagnose again when it changes"
    return NextStep(words, drive, (model_line(model),))


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
        return NextStep("these recordings excite too little; record the drive that shows more", plan)
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
    lines, without = [model_line(written)], list(refused)
    words = "drive with the written model"
    if without:
        lines.append(f"compensation_without: [{', '.join(without)}]")
        have = "has" if len(without) == 1 else "have"
        words += f"; {' and '.join(without)} {have} no inverse and cannot be driven, so leave that out knowingly"
    run: tuple[str, ...] = (command("check", bench or BENCH), command("run", bench or BENCH, "--arm"))
    if bench is not None:  # its daemon runs, and does not change its model by itself
        run = (*(command(verb, bench) for verb in ("check", "disarm", "reload", "arm")),)
    if any(rival.separation < 1.0 for finding in findings.effects for rival in finding.rivals):
        words += "; a rival is open, the planned drive decides"
        run = (*run, *plan)
    elif findings.verdict == "partly_explained":
        words += "; more is left, the planned drive shows more of it"
        run = (*run, *plan)
    return NextStep(words, run, tuple(lines))


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


def after_record(recording: Path, bench: Path, model: Path, *, model_exists: bool) -> NextStep:
    """Identify or diagnose the new recording.

    Parameters
    ----------
    model, model_exists
        Model of the bench file, and whether its file exists.
    """
    if model_exists:
        folder = f"{recording.stem}-diagnosis"
        return NextStep(
            "diagnose it with the model of the bench, or identify a new model",
            (
                command("diagnose", recording, "--model", model, "-o", folder),
                command("identify", recording, "-o", "new.yaml", "--report", "identified"),
            ),
        )
    made = command("identify", recording, "-o", model, "--report", f"{recording.stem}-identified")
    return NextStep(f"identify the model that {bench.name} names", (made,))


def after_convert(recording: Path, *, has_command: bool) -> NextStep:
    """Identify a model from the converted file, if it holds a command and a reading.

    Parameters
    ----------
    has_command
        Whether the recording has `voltage_V` and `force_N`.
    """
    if has_command:
        made = command("identify", recording, "-o", "model.yaml", "--report", "identified")
        return NextStep("identify a model from it", (made,))
    made = command("identify", recording, "-o", "model.yaml", "--input", "COLUMN", "--output", "COLUMN")
    return NextStep("identify a model from it; name its columns", (made,))


def after_report(recording: Path, *, fault: str, drifted: bool, config: Path = BENCH) -> NextStep:
    """Step after the end of a run.

    Parameters
    ----------
    fault
        Cause of a FAULT at its end; empty: none.
    drifted
        Whether the bench left its model during the run.
    config
        Bench file.
    """
    if fault:
        repeat = (command("check", config), command("reset", config))
        return NextStep(f"remove the cause ({fault.partition(';')[0]}), then check and reset", repeat)
    if drifted:
        return NextStep("the bench left its model: diagnose the kept recording", (from_bench(config),))
    diagnosis = command("diagnose", recording, "--model", "MODEL.yaml", "-o", "diagnosis")
    return NextStep("diagnose this recording if its error is larger than before", (diagnosis,))


def from_bench(config: Path) -> str:
    """Command that diagnoses the recording of a bench that has drifted."""
    return command("diagnose", "--from-bench", config, "-o", "diagnosis")


def after_check(config: Path, failed: Sequence[str], *, model_exists: bool) -> NextStep:
    """The first failure, or how to start.

    Parameters
    ----------
    failed
        Names of the failed checks, in order.
    model_exists
        Whether the model of the bench file exists.
    """
    if not model_exists:
        made = (
            command("record", config, "--excitation", RICH, "-o", "first.csv"),
            command("identify", "first.csv", "-o", "model.yaml", "--report", "identified"),
        )
        return NextStep("record the bench and identify its model", made)
    if failed:
        return NextStep(f"mend '{failed[0]}' first, then check again", (command("check", config),))
    return NextStep("the bench can run", (command("run", config, "--arm"),))


def after_proof(config: Path, *, passed: bool) -> NextStep:
    """Step after a proof test."""
    if passed:
        return NextStep("keep the record; the bench may run", (command("run", config, "--arm"),))
    return NextStep(
        "do not run the bench; mend the step that failed, then prove it again", (command("check", config, "--proof"),)
    )


def after_validate(
    config: Path | None, better: Path | None, *, better_than_none: bool, noises: float | None, complete: bool
) -> NextStep:
    """Which model to drive with.

    Parameters
    ----------
    config
        Bench file; None: an emulated bench.
    better
        File of the better model; None: no verdict.
    better_than_none
        Whether its error is smaller than without a model.
    noises
        Its rms error over the noise; None: the noise is unknown.
    complete
        Whether every run was completed.
    """
    bench = config or BENCH
    if better is None or not complete:
        return NextStep("find what ended the runs, then validate again", (command("check", bench),))
    if not better_than_none:
        repeat = (
            command("record", bench, "--excitation", RICH, "-o", "rich.csv"),
            command("identify", "rich.csv", "-o", "new.yaml"),
        )
        return NextStep("use none of these models; record the bench and identify again", repeat)
    run = [command("run", bench, "--arm")]
    words = f"drive with {better.name}"
    if config is None:
        run.insert(0, command("init", "-o", BENCH))
        words += " on the emulated bench; for your own bench make a bench file first"
    elif noises is not None and noises > AT_NOISE:
        run.append(command("investigate", bench, "--model", better, "-o", "investigation"))
        words += f"; its error is {noises:.2g} times the noise, an investigation tells why"
    return NextStep(words, tuple(run), (model_line(better),))


def after_investigate(config: Path | None, model: Path, written: Path, *, extended: bool, open_pairs: bool) -> NextStep:
    """Whether to drive further, or which model to use.

    Parameters
    ----------
    config
        Bench file; None: an emulated bench.
    model, written
        Given model, and the model of the last diagnosis.
    extended
        Whether the last diagnosis changed the model.
    open_pairs
        Whether a rival is open.
    """
    bench = config or BENCH
    if open_pairs:
        more = command(
            "investigate", bench, "--model", model, "--drives", 8, "--longest", 120, "-o", "investigation-more"
        )
        return NextStep("a rival is open; investigate with more and longer drives", (more,))
    if not extended:
        return NextStep("nothing: the given model describes the bench")
    validated = command("validate", bench, "--model", model, "--model", written, "--report", "validation.html")
    return NextStep("compare both models on the bench, then drive with the better one", (validated,))


def after_init(config: Path) -> NextStep:
    """Step after a new bench file."""
    return NextStep(
        "set each limit from the data sheet of stack, amplifier or load cell, then check",
        (command("config", "check", config), command("check", config)),
    )


def after_config_check(config: Path, *, model_exists: bool) -> NextStep:
    """Step after a valid bench file.

    Parameters
    ----------
    model_exists
        Whether its model exists.
    """
    if model_exists:
        return NextStep("check machine and device", (command("check", config),))
    return after_check(config, (), model_exists=False)


def after_latency(lines: Sequence[str], *, held: bool) -> NextStep:
    """Lines for the bench file that suit this machine.

    Parameters
    ----------
    lines
        Rate and limits, as YAML.
    held
        Whether the machine holds a measured rate.
    """
    words = (
        "limits that suit the pauses of this machine" if held else "end other programs and measure again, or use these"
    )
    return NextStep(words, (command("config", "check", BENCH),), tuple(lines))


def after_demo(*, passed: bool) -> NextStep:
    """Step after the demo."""
    if not passed:
        return NextStep("measure which rate this machine holds", (command("latency"),))
    return NextStep(
        "use your own recording, or make a bench file",
        (command("identify", "RECORDING.csv", "-o", "model.yaml", "--report", "identified"), command("init")),
    )


def after_status(status: dict[str, Any]) -> NextStep:
    """Step for the state of the daemon.

    Parameters
    ----------
    status
        Status that the daemon sends.
    """
    config = Path(status["config"])
    if not status["connected"]:
        return NextStep("the daemon connects again by itself; check the device", (command("check", config),))
    if status["state"] == "FAULT":
        return after_report(LATER, fault=status["cause"], drifted=False, config=config)
    if (status.get("drift") or {}).get("drifted"):
        return after_report(LATER, fault="", drifted=True, config=config)
    if status["state"] == "DISARMED":
        return NextStep("arm the bench when nobody is in its way", (command("arm", config),))
    return NextStep("watch it, or ramp down", (command("watch", config), command("disarm", config)))


def after_sequence(config: Path, sequence: Path, model: Path, *, passed: bool | None, fault: str) -> NextStep:
    """Step after a test sequence.

    Parameters
    ----------
    config, sequence, model
        Bench file, sequence, and model of the bench.
    passed
        Whether every limit is kept; None: checked only, not driven.
    fault
        Text of the latched fault; empty: none.
    """
    repeat = command("run", config, "--sequence", sequence, "--arm", "-o", f"{sequence.stem}-result")
    if passed is None:
        return NextStep("the checks passed; drive the sequence when nobody is in its way", (repeat,))
    if fault:
        return NextStep(f"remove the cause ({fault.partition(';')[0]}), then check", (command("check", config),))
    if passed:
        return NextStep("keep the results; compare them with those of the next test")
    words = "find the reason: an investigation tells whether the bench left its model"
    bench = command("investigate", config, "--model", model, "-o", "investigation")
    return NextStep(words, (bench, repeat))


def after_run(config: Path, recordings: Path | None, *, fault: str, drifted: bool) -> NextStep:
    """Step after the end of `piezod run --arm`.

    Parameters
    ----------
    recordings
        Folder of the recorder; None: without a recorder.
    fault, drifted
        As for `after_report`.
    """
    if fault or drifted:
        return after_report(LATER, fault=fault, drifted=drifted, config=config)
    if recordings is None:
        return NextStep("nothing; a section recorder in the bench file keeps every tick for a page")
    newest = f'piezod report "$(ls -t {shlex.quote(str(recordings))}/*.sqlite | head -1)" -o run.html'
    return NextStep("look at the page of the run", (newest,))
