"""`python -m firmware_sim.concealed make|score`: makes a concealed study, and scores the findings on it."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.second_input import OUTSIDE_CATALOGUE
from firmware_sim.concealed.scoring.lives.report import lives_as_json, lives_as_text
from firmware_sim.concealed.scoring.lives.score import score_lives
from firmware_sim.concealed.scoring.report import as_json, as_text
from firmware_sim.concealed.scoring.study_score import score_study
from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.life_truth import holds_lives
from firmware_sim.concealed.study.make import make
from firmware_sim.concealed.study.make_lives import make_lives
from firmware_sim.concealed.study.plan import KINDS

EXIT_CONFIGURATION = 78


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the verb of the command line; return the exit code.

    Parameters
    ----------
    arguments
        Command line without the program's name; None: that of the process.
    """
    options = _parser().parse_args(arguments)
    try:
        _make(options) if options.verb == "make" else _score(options)
    except StudyError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_CONFIGURATION
    return 0


def _make(options: argparse.Namespace) -> None:
    if options.lives is not None:
        make_lives(
            options.directory,
            options.lives,
            seed=options.seed,
            families=tuple(FAMILIES) if options.family in ("", "each") else (options.family,),
            jobs=options.jobs,
            progress=_show if sys.stderr.isatty() else None,
        )
        return
    make(
        options.directory,
        options.cases,
        seed=options.seed,
        kind=options.kind,
        effect=options.effect,
        strength=options.strength,
        families=tuple(FAMILIES) if options.family == "each" else (options.family,),
        amid_s=options.amid,
        varied=options.varied,
        jobs=options.jobs,
        progress=_show if sys.stderr.isatty() else None,
    )


def _score(options: argparse.Namespace) -> None:
    if holds_lives(options.directory):
        lives = score_lives(options.directory, options.verdicts, partial=options.partial)
        sys.stdout.write(json.dumps(lives_as_json(lives), indent=1) + "\n" if options.json else lives_as_text(lives))
        return
    scores = score_study(options.directory, options.verdicts, partial=options.partial)
    sys.stdout.write(json.dumps(as_json(scores), indent=1) + "\n" if options.json else as_text(scores))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m firmware_sim.concealed", description="Concealed cases and their scoring."
    )
    verbs = parser.add_subparsers(required=True, dest="verb")
    maker = verbs.add_parser("make", help="draw the cases and seal their truth")
    maker.add_argument("directory", type=Path, metavar="DIR")
    numbers = maker.add_mutually_exclusive_group(required=True)
    numbers.add_argument("--cases", type=int, metavar="N", help="number of cases")
    numbers.add_argument("--lives", type=int, metavar="N", help="number of lives: benches with five recordings each")
    maker.add_argument(
        "--seed", type=int, help="seed; the same seed makes the same study (default: from the operating system)"
    )
    maker.add_argument("--kind", choices=("all", *KINDS), default="all", help="kind of the cases")
    maker.add_argument(
        "--effect", choices=(*ENTRIES, *OUTSIDE_CATALOGUE), metavar="NAME", help="effect of every case except nulls"
    )
    maker.add_argument(
        "--strength",
        type=float,
        metavar="X",
        help="strength of the effects [noise rms] (default: 0.8, 4 and 20 in turn)",
    )
    maker.add_argument(
        "--family",
        choices=(*FAMILIES, "each"),
        default="",
        help="plants of one family, or of each in turn (default: laws drawn for each case)",
    )
    maker.add_argument(
        "--amid",
        type=float,
        default=0.0,
        metavar="S",
        help="seconds missing at the begin of the recordings of every third case (default: 0)",
    )
    maker.add_argument(
        "--varied",
        action="store_true",
        help="benches as laboratories have them: rate, start, tare, voltmeter and kinds of command are drawn",
    )
    maker.add_argument("--jobs", type=int, default=1, help="number of processes")
    scorer = verbs.add_parser("score", help="open the sealed truth and score the findings")
    scorer.add_argument("directory", type=Path, metavar="DIR")
    scorer.add_argument("verdicts", type=Path, metavar="VERDICTS", help="folder with case_0001/findings.json and so on")
    scorer.add_argument("--json", action="store_true", help="print JSON with every figure and every case")
    scorer.add_argument("--partial", action="store_true", help="leave out cases without findings")
    return parser


def _show(done: int, cases: int) -> None:
    sys.stderr.write(f"\r{done}/{cases}" + ("\n" if done == cases else ""))
