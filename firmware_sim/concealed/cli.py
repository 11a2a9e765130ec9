"""`python -m firmware_sim.concealed make|score`: the two ends of a concealed study."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.scoring.report import as_json, as_text
from firmware_sim.concealed.scoring.score import score
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.make import make
from firmware_sim.concealed.study.plan import KINDS

EXIT_CONFIGURATION = 78


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the command line says; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        _make(options) if options.verb == "make" else _score(options)
    except StudyError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_CONFIGURATION
    return 0


def _make(options: argparse.Namespace) -> None:
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


def _score(options: argparse.Namespace) -> None:
    judged = score(options.directory, options.verdicts, partial=options.partial)
    sys.stdout.write(json.dumps(as_json(judged), indent=1) + "\n" if options.json else as_text(judged))


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
    scorer = verbs.add_parser("score", help="open the truth and judge the verdicts")
    scorer.add_argument("directory", type=Path, metavar="DIR")
    scorer.add_argument("verdicts", type=Path, metavar="VERDICTS", help="VERDICTS/case_0001/findings.json and so on")
    scorer.add_argument("--json", action="store_true", help="every figure and every case")
    scorer.add_argument("--partial", action="store_true", help="leave out cases without a verdict")
    return parser


def _show(done: int, cases: int) -> None:
    sys.stderr.write(f"\r{done}/{cases}" + ("\n" if done == cases else ""))
