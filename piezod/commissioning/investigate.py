"""`piezod investigate`: record, diagnose, plan the next experiment, and again, until nothing is open."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezod.commissioning.record import excitation_duration_s, record_excitation
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.diagnosis import Diagnosis
from piezod.diagnose.experiment import Experiment, next_experiment, separation
from piezod.diagnose.findings import Findings
from piezod.diagnose.isolability import isolability
from piezod.diagnose.prepare import past_sources, read_source
from piezod.model import load_model
from piezod.recording import write_recording
from piezod.session.follow import OnRows

Pairs = tuple[tuple[str, str], ...]
PERIODS = 1
FREQUENCY_HZ = 0.1
OPEN = 0.45
"""Separation of a rival [noise] below which it is open: three times the scale at which a rival costs confidence."""


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
    """What one drive showed.

    Parameters
    ----------
    recording
        File of the drive's recording.
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


def open_pairs(findings: Findings) -> Pairs:
    """Effects found, each with a rival that the recordings do not exclude.

    Parameters
    ----------
    findings
        Result of a diagnosis.
    """
    return tuple((one.name, rival.name) for one in findings.effects for rival in one.rivals if rival.separation < OPEN)


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
    config
        Bench configuration.
    model_path
        Identified model.
    output
        Folder for recordings, drives and findings.
    excitation
        First excitation.
    most_drives
        Largest number of drives.
    longest_s
        Longest duration of a planned drive [s].
    agreed
        Asked before every drive; False ends the investigation.
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
    recordings: list[Path] = []
    planned: Experiment | None = None
    for number in range(1, most_drives + 1):
        drive = Drive(number, excitation, excitation_duration_s(excitation, FREQUENCY_HZ, PERIODS))
        if not agreed(drive):
            return
        recorded, _ = record_excitation(
            config,
            excitation,
            peak_V=None,
            frequency_Hz=FREQUENCY_HZ,
            periods=PERIODS,
            reset_cycle=False,
            on_rows=on_rows,
        )
        recordings.append(output / f"work_{number}.csv")
        write_recording(recorded, recordings[-1])
        folder = output / f"diagnosis_{number}"
        diagnosis = diagnose_files(recordings, model_path, folder, None, None, on_step)
        asked = [read_source(path, "recording", channels) for path in recordings]
        past, _ = past_sources(model, model_path.parent, asked)
        known = isolability(model, asked, past)
        pairs = open_pairs(diagnosis.findings)
        reached = () if planned is None else tuple(separation(known, pair.first, pair.second) for pair in planned.pairs)
        yield Step(recordings[-1], folder, diagnosis, pairs, planned, reached)
        if not pairs:
            return
        planned = next_experiment(model, asked, past, known, longest_s, pairs)
        if planned is None:
            return
        excitation = str(output / f"drive_{number + 1}.csv")
        write_recording(planned.recording(channels[0]), Path(excitation))
