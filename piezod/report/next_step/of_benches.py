"""Next steps after commands on a bench and its runs, one function for each command."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from piezod.report.next_step import AT_NOISE, BENCH, LATER, RICH, NextStep, command, model_line

MANY_MISSED = 0.01  # share of missed ticks from which they explain an error


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


def after_report(recording: Path, *, fault: str, drifted: bool, config: Path = BENCH, missed: float = 0.0) -> NextStep:
    """Step after the end of a run.

    Parameters
    ----------
    fault
        Cause of a FAULT at its end; empty: none.
    drifted
        Whether the bench left its model during the run.
    missed
        Share of missed ticks.
    """
    if fault:
        repeat = (command("check", config), command("reset", config))
        return NextStep(f"remove the cause ({fault.partition(';')[0]}), then check and reset", repeat)
    if drifted:
        return NextStep("the bench left its model: diagnose the kept recording", (from_bench(config),))
    if missed > MANY_MISSED:
        words = f"{100.0 * missed:.2g} % of the ticks were missed, so the errors are of this machine: measure its rate"
        return NextStep(words, (command("latency"),))
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


def after_discover(host: str | None, port: int | None) -> NextStep:
    """Make a bench file for a device that was found, or look at its address.

    Parameters
    ----------
    host, port
        Address that was read; None: none, and 502.
    """
    if host is None:
        words = "look at the address of a device too"
        return NextStep(words, (command("init", "--discover", "--host", "HOST"),))
    where = ["--host", host, *(["--port", port] if port is not None else [])]
    made = command("init", "--yes", "--profile", "bench", *where, "-o", BENCH)
    return NextStep("make a bench file from the profile that is nearest to the device", (made,))


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
    """Step for the state of the daemon."""
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
