"""`piezod investigate`: record, diagnose, and plan the next experiment, repeatedly, until no question is open."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from piezod.commissioning.record import excitation_duration_s, record_excitation
from piezod.daemon.run import rows_are_saved
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.experiment.isolability import Isolability, isolability
from piezod.diagnose.experiment.planning import Experiment, next_experiment, separation
from piezod.diagnose.findings import Findings
from piezod.diagnose.judgement import Diagnosis
from piezod.errors import CheckFailedError
from piezod.estimation.recordings.sources import past_sources, read_source
from piezod.model import load_model
from piezod.recording import Recording, write_recording
from piezod.report.isolability import promise_text
from piezod.session.assembly import load_bench_without_model
from piezod.session.history import OnRows

Pairs = tuple[tuple[str, str], ...]
PERIODS = 1
FREQUENCY_HZ = 0.1
LONGEST_REST_S = 600.0
"""Longest rest between two drives that is simulated [s]: after ten minutes creep is below the noise."""


@dataclass(frozen=True)
class Drive:
    """A drive that is about to begin.

    Parameters
    ----------
    number
        1 for the first one.
    excitation
        Name of an excitation, or file of a planned one.
    duration_s
        Its duration [s].
    """

    number: int
    excitation: str
    duration_s: float


@dataclass(frozen=True)
class Step:
    """Results after a drive.

    Parameters
    ----------
    folder
        Folder with the findings from all recordings so far.
    diagnosis
        These findings.
    open_pairs
        Effects found, each with a rival that the recordings do not exclude.
    promised
        Experiment that led to this drive; None for the first one.
    reached
        Sizes from which on its pairs are separated with the recording, in noises.
    """

    recording: Path
    folder: Path
    diagnosis: Diagnosis
    open_pairs: Pairs
    promised: Experiment | None
    reached: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        planned = self.promised
        pairs = () if planned is None else zip(planned.pairs, planned.sizes, self.reached, strict=True)
        return {
            "recording": str(self.recording),
            "findings": self.diagnosis.findings.as_dict(),
            "open": [list(pair) for pair in self.open_pairs],
            "promised": [
                {"first": pair.first, "second": pair.second, "promised_noises": size, "reached_noises": reached}
                for pair, size, reached in pairs
            ],
        }


def step_text(step: Step) -> str:
    """Findings, comparison with the plan, and open pairs of a step, for a terminal."""
    findings = step.diagnosis.findings
    lines = [f"{findings.verdict.replace('_', ' ')}: {findings.words}"]
    if step.promised is not None:
        lines.append(promise_text(step.promised, step.reached))
    lines += [f"open: {name} or {rival}" for name, rival in step.open_pairs]
    if findings.effects and not step.open_pairs:
        lines.append("no rival is open: each effect is larger than what separates it from its rivals")
    return "\n".join(lines)


def open_pairs(findings: Findings, known: Isolability) -> Pairs:
    """Effects found, each with a rival, that are smaller than the size from which the recordings separate both.

    Parameters
    ----------
    known
        Effects that the recordings can separate.
    """
    pairs = []
    for effect in findings.effects:
        size = math.sqrt(max(effect.before**2 - effect.after**2, 0.0)) / known.noise
        rivals = [rival.name for rival in effect.rivals]
        pairs += [(effect.name, rival) for rival in rivals if size < separation(known, effect.name, rival)]
    return tuple(pairs)


def joined(first: Recording, second: Recording, rest_V: float) -> Recording:
    """Two recordings of one bench as one, since the stack remembers the first while the second is driven.

    During the pause the voltage rests and no force is known. The clock gives the length of the pause, at most
    `LONGEST_REST_S`.

    Parameters
    ----------
    first, second
        Recordings with `voltage_V` and `force_N`, and the time at which each was complete as metadata `recorded`.
    rest_V
        Voltage during the pause [V].
    """
    dt_s = first.dt_s
    ends = [datetime.fromisoformat(recording.metadata["recorded"]) for recording in (first, second)]
    rest_s = (ends[1] - ends[0]).total_seconds() - float(second.time_s[-1] - second.time_s[0])
    count = max(1, round(min(max(rest_s, 0.0), LONGEST_REST_S) / dt_s))
    between = {"voltage_V": np.full(count, rest_V), "force_N": np.full(count, np.nan)}
    channels = {name: np.concatenate((first.channel(name), between[name], second.channel(name))) for name in between}
    begin_s = float(first.time_s[-1]) + (count + 1) * dt_s
    time_s = np.concatenate(
        (
            first.time_s,
            float(first.time_s[-1]) + dt_s * np.arange(1, count + 1),
            begin_s + second.time_s - second.time_s[0],
        )
    )
    return Recording(time_s, channels, first.metadata | {"recorded": second.metadata["recorded"]}, "work")


def investigate(
    config: Path,
    model_path: Path,
    output: Path,
    *,
    excitation: str,
    most_drives: int,
    longest_s: float,
    agreed: Callable[[Drive], bool],
    on_rows: OnRows,
    on_step: Callable[[str, float | None], None],
) -> Iterator[Step]:
    """Record and diagnose a bench until no rival is left open.

    Parameters
    ----------
    output
        Folder for recordings, drives and findings.
    excitation
        First excitation.
    longest_s
        Longest duration of a planned drive [s].
    agreed
        Called before every drive; False ends the investigation.
    on_rows, on_step
        Progress of a drive, and of a diagnosis.

    Yields
    ------
    Step
        After every drive.

    Raises
    ------
    CheckFailedError
        A fault ended a drive early.
    """
    model = load_model(model_path)
    channels = model.input.channel, model.output.channel
    limits = load_bench_without_model(config).limits
    rest_V, slew = limits.voltage_safe_V, min(limits.slew_V_per_s, limits.fall_V_per_s)
    all_drives: Recording | None = None
    planned: Experiment | None = None
    for number in range(1, most_drives + 1):
        drive = Drive(number, excitation, excitation_duration_s(excitation, FREQUENCY_HZ, PERIODS))
        if not agreed(drive):
            return
        recorded, outcome = record_excitation(
            config,
            excitation,
            peak_V=None,
            frequency_Hz=FREQUENCY_HZ,
            periods=PERIODS,
            reset_cycle=False,
            on_rows=on_rows,
        )
        own, joint = output / f"work_{number}.csv", output / "work.csv"
        if recorded.time_s.size:
            write_recording(recorded, own)
        rows_are_saved()
        if outcome.stopped:
            raise KeyboardInterrupt  # Ctrl-C ended the drive, and with it the investigation
        if outcome.fault:
            raise CheckFailedError(f"{own}: the drive ended early: {recorded.metadata['incomplete']}")
        all_drives = recorded if all_drives is None else joined(all_drives, recorded, rest_V)
        write_recording(all_drives, joint)
        folder = output / f"diagnosis_{number}"
        diagnosis = diagnose_files([joint], model_path, folder, None, None, on_step)
        sources = [read_source(joint, "recording", channels)]
        past, _ = past_sources(model, model_path.parent, sources)
        fitted = diagnosis.fitted()
        known = isolability(model, sources, past, fitted)
        pairs = open_pairs(diagnosis.findings, known)
        reached = () if planned is None else tuple(separation(known, pair.first, pair.second) for pair in planned.pairs)
        yield Step(own, folder, diagnosis, pairs, planned, reached)
        if not pairs:
            return
        planned = next_experiment(model, sources, past, known, longest_s, pairs, fitted, slew)
        if planned is None:
            return
        excitation = str(output / f"drive_{number + 1}.csv")
        write_recording(planned.recording(channels[0]), Path(excitation))
