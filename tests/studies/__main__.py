"""The command: run a study and print its table."""

import argparse
import contextlib
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.studies import recorder, soak
from tests.studies.peers import command as peers
from tests.studies.scenarios import LONG, SHORT, study
from tests.studies.strengths import SWITCHED
from tests.studies.table import header, summary


def main() -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__)
    studies = parser.add_subparsers(dest="study", required=True)
    scenarios = studies.add_parser(
        "scenarios", help="every effect of the catalogue on the emulated bench, over its link"
    )
    scenarios.add_argument("--only", metavar="NAME,...", help=f"of {', '.join(SWITCHED)}; all when left out")
    scenarios.add_argument("--jobs", type=int, default=2, metavar="N", help="cases at a time, a core each")
    scenarios.add_argument("--short", action="store_true", help="short recordings")
    scenarios.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON too")
    scenarios.add_argument("--folder", type=Path, metavar="DIR", help="keep recordings and findings there")
    peers.add_options(studies.add_parser("peers", help="other methods on the cases of a concealed study"))
    recorder.add_options(studies.add_parser("recorder", help="the recorder killed, without power, on a failing disk"))
    soak.add_options(studies.add_parser("soak", help="the daemon for a long time on a busy machine, beside cyclictest"))
    options = parser.parse_args()
    if options.study in ("peers", "recorder", "soak"):
        options.run(options, parser)
        return
    names = options.only.split(",") if options.only else list(SWITCHED)
    if unknown := sorted(set(names) - set(SWITCHED)):
        parser.error(f"no scenario is called {', '.join(unknown)}; there are {', '.join(SWITCHED)}")
    print(header(), flush=True)
    rows = []
    with _folder(options.folder) as folder:
        for row in study(names, SHORT if options.short else LONG, folder, jobs=options.jobs):
            print(row.text(), flush=True)
            rows.append(row)
    print(summary(rows))
    if options.json:
        options.json.write_text(json.dumps([row.as_dict() for row in rows], indent=2) + "\n", encoding="utf-8")


@contextlib.contextmanager
def _folder(wanted: Path | None) -> Iterator[Path]:
    """Where the recordings lie: kept when a folder is named."""
    if wanted is not None:
        wanted.mkdir(parents=True, exist_ok=True)
        yield wanted
        return
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


if __name__ == "__main__":
    main()
