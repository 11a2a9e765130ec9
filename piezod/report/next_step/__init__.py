"""A next step: action and reason, with the commands to paste and the lines of a bench file.

One function for each command chooses it: `of_benches.py`, `of_models.py`, `of_studies.py`. A file that the user does
not have yet is in capitals, as in the help: BENCH.yaml.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BENCH, LATER = Path("BENCH.yaml"), Path("LATER.csv")
AT_NOISE = 1.3  # error, in multiples of the noise, that counts as noise: `diagnose.findings.ABOVE_NOISE`
RESTING = 1.1  # limit for held-out data of an identification: `identify.identification.AT_THE_NOISE`
STRUCTURED = 3.0  # error of a useless model, in multiples of the noise, above which it has structure: as in `identify`
CLOSE = 0.99
"""Explained share of the variance below which a static model lacks more than noise: identified stacks reach 0.999."""
RICH = "staircase-minor-loops-multisine"  # excitation that shows most effects: rests, minor loops, and many rates


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


def recorded_and_diagnosed(model: Path, folder: object, name: str = "later.csv") -> tuple[str, str]:
    """Commands that record a rich excitation and diagnose the recording.

    Parameters
    ----------
    model, folder
        Given model, and folder of the diagnosis.
    name
        File of the recording.
    """
    record = command("record", BENCH, "--excitation", RICH, "-o", name)
    return record, command("diagnose", name, "--model", model, "-o", folder)


def model_line(model: Path) -> str:
    """Line of a bench file that names a model, valid in every folder."""
    return f"model: {model.resolve()}"
