"""The command: run a study and print its table."""

import argparse
import contextlib
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.studies import compensation, effects_compensated, flexure, overlay, recorder, scenarios, soak, table
from tests.studies.laid_over import LAID_OVER, NOT_LAID_OVER
from tests.studies.peers import command as peers
from tests.studies.strengths import SWITCHED


def main() -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__)
    studies = parser.add_subparsers(dest="study", required=True)
    _scenarios(studies.add_parser("scenarios", help="every effect on the emulated bench, over its link"))
    _overlay(studies.add_parser("overlay", help="effects laid over real recordings"))
    _compensation(
        studies.add_parser("compensation", help="plain gain, static and extended inverse on the emulated bench")
    )
    _flexure(studies.add_parser("flexure", help="what a diagnosed model predicts of a real feedforward"))
    _effects_compensated(studies.add_parser("effects_compensated", help="each effect alone, before and after"))
    peers.add_options(studies.add_parser("peers", help="other methods on the cases of a concealed study"))
    recorder.add_options(studies.add_parser("recorder", help="the recorder killed, without power, on a failing disk"))
    soak.add_options(studies.add_parser("soak", help="the daemon for a long time on a busy machine, beside cyclictest"))
    options = parser.parse_args()
    options.run(options, parser)


def _scenarios(parser: argparse.ArgumentParser) -> None:
    _shared(parser, SWITCHED)

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        names = _picked(parser, "scenario", options.only, SWITCHED)
        size = scenarios.SHORT if options.short else scenarios.LONG
        with _folder(options.folder) as folder:
            rows = scenarios.study(names, size, folder, jobs=options.jobs)
            _told(rows, table.header(), table.summary, options.json)

    parser.set_defaults(run=run)


def _overlay(parser: argparse.ArgumentParser) -> None:
    _shared(parser, LAID_OVER)
    parser.epilog = f"Not laid over, as the real stack never got these voltages: {NOT_LAID_OVER}."
    parser.add_argument("--bench", metavar="NAME,...", help=f"of {', '.join(overlay.BENCHES)}; all when left out")
    parser.add_argument(
        "--strength", type=float, default=overlay.STRENGTH, metavar="X", help="change over what is left, %(default)g"
    )

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        effects = _picked(parser, "effect that can be laid over", options.only, LAID_OVER)
        benches = _picked(parser, "bench", options.bench, overlay.BENCHES)
        if not overlay.REAL.is_dir():
            parser.error(f"{overlay.REAL} is not here: the real recordings are not part of the project")
        with _folder(options.folder) as folder:
            rows = overlay.overlay_study(
                benches, effects, folder, short=options.short, strength=options.strength, jobs=options.jobs
            )
            _told(rows, overlay.header(), overlay.summary, options.json)

    parser.set_defaults(run=run)


def _compensation(parser: argparse.ArgumentParser) -> None:
    _shared(parser, compensation.HIDDEN)
    parser.add_argument("--rates", metavar="HZ,...", default="200,1000", help="of the loop, %(default)s")

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        benches = _picked(parser, "bench", options.only or compensation.FIRST, compensation.HIDDEN)
        rates_Hz = [float(one) for one in options.rates.split(",")]
        extent = compensation.SHORT if options.short else compensation.LONG
        with _folder(options.folder) as folder:
            rows = compensation.study(benches, rates_Hz, extent, folder)
            _told(rows, compensation.header(), compensation.summary, options.json)

    parser.set_defaults(run=run)


def _effects_compensated(parser: argparse.ArgumentParser) -> None:
    names = [name for name in SWITCHED if name != "none"]
    _shared(parser, names)

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        chosen = _picked(parser, "effect", options.only, names)
        size = scenarios.SHORT if options.short else scenarios.LONG
        with _folder(options.folder) as folder:
            rows = effects_compensated.study(chosen, size, folder, jobs=options.jobs)
            _told(rows, effects_compensated.header(), effects_compensated.summary, options.json)

    parser.set_defaults(run=run)


def _flexure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON too")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep models and findings there")

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        if not flexure.REAL.is_dir():
            parser.error(f"{flexure.REAL} is not here: the real recordings are not part of the project")
        with _folder(options.folder) as folder:
            _told(flexure.study(folder), flexure.header(), flexure.summary, options.json)

    parser.set_defaults(run=run)


def _shared(parser: argparse.ArgumentParser, names: Sequence[str]) -> None:
    """Options that all studies have."""
    parser.add_argument("--only", metavar="NAME,...", help=f"of {', '.join(names)}; all when left out")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="cases at a time, a core each")
    parser.add_argument("--short", action="store_true", help="short recordings")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON too")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep recordings and findings there")


def _picked(parser: argparse.ArgumentParser, what: str, wanted: str | None, known: Sequence[str]) -> list[str]:
    """Names of a list with commas, all of them when there is none."""
    names = wanted.split(",") if wanted else list(known)
    if unknown := sorted(set(names) - set(known)):
        parser.error(f"no {what} is called {', '.join(unknown)}; there are {', '.join(known)}")
    return names


def _told(rows: Iterator, header: str, summary: Callable[[list], str], to_json: Path | None) -> None:
    """Print rows as they come, what they say together, and write them."""
    print(header, flush=True)
    kept = []
    for row in rows:
        print(row.text(), flush=True)
        kept.append(row)
    print(summary(kept))
    if to_json:
        to_json.write_text(json.dumps([row.as_dict() for row in kept], indent=2) + "\n", encoding="utf-8")


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
