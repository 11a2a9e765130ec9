"""`python -m firmware_sim.concealed make|score`: the two ends of a concealed study."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.concealed.catalogue import ENTRIES
from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.foreign import FOREIGN
from firmware_sim.concealed.make import make
from firmware_sim.concealed.plan import KINDS

EXIT_CONFIGURATION = 78


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the command line says; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        make(
            options.directory,
            options.cases,
            seed=options.seed,
            kind=options.kind,
            effect=options.effect,
            strength=options.strength,
            jobs=options.jobs,
            progress=_show if sys.stderr.isatty() else None,
        )
    except StudyError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_CONFIGURATION
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m firmware_sim.concealed", description="Concealed cases and their scoring."
    )
    verbs = parser.add_subparsers(required=True, dest="verb")
    maker = verbs.add_parser("make", help="draw cases, and seal the truth")
    maker.add_argument("directory", type=Path, metavar="DIR")
    maker.add_argument("--cases", type=int, required=True, metavar="N")
    maker.add_argument("--seed", type=int, help="the same seed makes the same study; else the operating system's")
    maker.add_argument("--kind", choices=("all", *KINDS), default="all")
    maker.add_argument("--effect", choices=(*ENTRIES, *FOREIGN), metavar="NAME", help="in every case that is no null")
    maker.add_argument("--strength", type=float, metavar="X", help="in parts of the noise; 0.8, 4 and 20 in turn")
    maker.add_argument("--jobs", type=int, default=1, help="processes")
    return parser


def _show(done: int, cases: int) -> None:
    sys.stderr.write(f"\r{done}/{cases}" + ("\n" if done == cases else ""))
