"""Options and exit codes of `python -m tests.studies peers`."""

import argparse
import json
import sys
import tempfile
from pathlib import Path

from piezod.errors import PiezodError
from tests.studies.peers.environments import cache_folder
from tests.studies.peers.run import PEERS
from tests.studies.peers.study import Wanted, compare


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this study to a parser."""
    parser.add_argument("concealed", type=Path, metavar="STUDY", help="made by piezod blind make")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS", help="made by piezod blind run")
    parser.add_argument("--only", metavar="CASE,...", help="cases such as case_0001; default: all")
    parser.add_argument("--cases", type=int, metavar="N", help="only the first N of them")
    parser.add_argument("--peers", default=",".join(PEERS), metavar="PEER,...", help=f"of {', '.join(PEERS)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures of each case as JSON")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep the answers there; a later run goes on")
    parser.add_argument("--cache", type=Path, default=cache_folder(), metavar="DIR", help="environments of the peers")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Run the comparison; exit code 1 when a case is skipped or a peer failed."""
    if options.cases is not None and options.cases < 1:
        parser.error(f"--cases is {options.cases}, must be at least 1")
    only = tuple(options.only.split(",")) if options.only else ()
    wanted = Wanted(options.concealed, options.verdicts, only, options.cases, tuple(options.peers.split(",")))
    try:
        with tempfile.TemporaryDirectory() as temporary:
            folder = options.folder or Path(temporary)
            folder.mkdir(parents=True, exist_ok=True)
            compared = compare(wanted, folder, options.cache)
    except PiezodError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    if options.json:
        rows = [row.as_dict() for row in compared.rows]
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    if not compared.whole:
        sys.exit(1)
