"""Command line: run a study and print its table."""

import argparse
import contextlib
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.studies import (
    api_calls,
    archive,
    compensation,
    daily_check,
    drift_alarm,
    effects_compensated,
    flexure,
    learning,
    learning_concealed,
    lisdd,
    lives,
    load,
    messy_files,
    new_user,
    nulls,
    overlay,
    real_recordings,
    recorder,
    rivals,
    rules,
    scenarios,
    soak,
    table,
)
from tests.studies.overlaid_effects import NOT_OVERLAID, OVERLAYS
from tests.studies.peers import command as peers
from tests.studies.strengths import SWITCHED


def main() -> None:
    """Run the chosen study."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__)
    studies = parser.add_subparsers(dest="study", required=True)
    _scenarios(studies.add_parser("scenarios", help="every effect on the emulated bench, over its link"))
    _overlay(studies.add_parser("overlay", help="effects laid over real recordings"))
    _compensation(
        studies.add_parser("compensation", help="plain gain, static and extended inverse on the emulated bench")
    )
    _flexure(studies.add_parser("flexure", help="prediction of a real feedforward by a diagnosed model"))
    _effects_compensated(studies.add_parser("effects_compensated", help="each effect before and after compensation"))
    _learning(studies.add_parser("learning", help="a looped reference with each effect hidden, repeat by repeat"))
    learning_concealed.add_options(
        studies.add_parser("learning_concealed", help="learning on concealed plants of four families")
    )
    peers.add_options(studies.add_parser("peers", help="other methods on the cases of a concealed study"))
    rivals.add_options(studies.add_parser("rivals", help="the next experiment where a diagnosis left rivals"))
    rules.add_options(studies.add_parser("rules", help="the rule of the search on replay files, families left out"))
    lives.add_options(studies.add_parser("lives", help="five recordings of a bench with one change, concealed plants"))
    archive.add_options(
        studies.add_parser("fleet", help="an archive of recordings of ten benches, diagnosed by piezod history"),
        studies.add_parser("year", help="one bench over a year: creep grows, a repair, a colder week"),
    )
    lisdd.add_options(studies.add_parser("lisdd", help="LISDD on the cases of a concealed study"))
    recorder.add_options(studies.add_parser("recorder", help="the recorder under kills, power cuts and disk failures"))
    api_calls.add_options(studies.add_parser("api_calls", help="calls of the Python interface, right and wrong"))
    messy_files.add_options(studies.add_parser("messy_files", help="text of spreadsheets and instruments"))
    real_recordings.add_options(
        studies.add_parser("real_recordings", help="measured recordings of other machines, beside simulation")
    )
    nulls.add_options(studies.add_parser("nulls", help="identified models on benches with nothing wrong in them"))
    daily_check.add_options(
        studies.add_parser("daily_check", help="ticks missed while the daily check runs, beside the bench alone")
    )
    drift_alarm.add_options(
        studies.add_parser("drift_alarm", help="false alarms and delay of the drift watch, simulated days")
    )
    new_user.add_options(studies.add_parser("new_user", help="the first day of a user, with a stopwatch"))
    soak.add_options(studies.add_parser("soak", help="a long run of the daemon on a busy machine, beside cyclictest"))
    load.add_options(
        studies.add_parser("load", help="the daemon with clients, live page, recorder and MQTT, and alone")
    )
    options = parser.parse_args()
    options.run(options, parser)


def _scenarios(parser: argparse.ArgumentParser) -> None:
    _shared(parser, SWITCHED)

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        names = _picked(parser, "scenario", options.only, SWITCHED)
        size = scenarios.SHORT if options.short else scenarios.LONG
        with _folder(options.folder) as folder:
            rows = scenarios.study(names, size, folder, jobs=options.jobs)
            _print_rows(rows, table.header(), table.summary, options.json)

    parser.set_defaults(run=run)


def _overlay(parser: argparse.ArgumentParser) -> None:
    _shared(parser, OVERLAYS)
    parser.epilog = f"Not available, since the real stack never received such voltages: {NOT_OVERLAID}."
    parser.add_argument("--bench", metavar="NAME,...", help=f"of {', '.join(overlay.BENCHES)}; default: all")
    parser.add_argument(
        "--strength",
        type=float,
        default=overlay.STRENGTH,
        metavar="X",
        help="change over the residual, %(default)g",
    )

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        effects = _picked(parser, "effect that can be laid over", options.only, OVERLAYS)
        benches = _picked(parser, "bench", options.bench, overlay.BENCHES)
        if not overlay.REAL.is_dir():
            parser.error(f"{overlay.REAL} does not exist: the real recordings are not part of the project")
        with _folder(options.folder) as folder:
            rows = overlay.overlay_study(
                benches, effects, folder, short=options.short, strength=options.strength, jobs=options.jobs
            )
            _print_rows(rows, overlay.header(), overlay.summary, options.json)

    parser.set_defaults(run=run)


def _compensation(parser: argparse.ArgumentParser) -> None:
    _shared(parser, compensation.HIDDEN)
    parser.add_argument("--rates", metavar="HZ,...", default="200,1000", help="rates of the loop, %(default)s")

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        benches = _picked(parser, "bench", options.only or compensation.FIRST, compensation.HIDDEN)
        rates_Hz = [float(one) for one in options.rates.split(",")]
        extent = compensation.SHORT if options.short else compensation.LONG
        with _folder(options.folder) as folder:
            rows = compensation.study(benches, rates_Hz, extent, folder)
            _print_rows(rows, compensation.header(), compensation.summary, options.json)

    parser.set_defaults(run=run)


def _learning(parser: argparse.ArgumentParser) -> None:
    _shared(parser, learning.CASES)

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        names = _picked(parser, "case", options.only, learning.CASES)
        with _folder(options.folder) as folder:
            rows = learning.study(names, folder, jobs=options.jobs)
            _print_rows(rows, learning.header(), learning.summary, options.json)

    parser.set_defaults(run=run)


def _effects_compensated(parser: argparse.ArgumentParser) -> None:
    names = [name for name in SWITCHED if name != "none"]
    _shared(parser, names)

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        chosen = _picked(parser, "effect", options.only, names)
        size = scenarios.SHORT if options.short else scenarios.LONG
        with _folder(options.folder) as folder:
            rows = effects_compensated.study(chosen, size, folder, jobs=options.jobs)
            _print_rows(rows, effects_compensated.header(), effects_compensated.summary, options.json)

    parser.set_defaults(run=run)


def _flexure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep models and findings there")

    def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
        if not flexure.REAL.is_dir():
            parser.error(f"{flexure.REAL} does not exist: the real recordings are not part of the project")
        with _folder(options.folder) as folder:
            _print_rows(flexure.study(folder), flexure.header(), flexure.summary, options.json)

    parser.set_defaults(run=run)


def _shared(parser: argparse.ArgumentParser, names: Sequence[str]) -> None:
    """Add the options common to the studies."""
    parser.add_argument("--only", metavar="NAME,...", help=f"of {', '.join(names)}; default: all")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel cases, one core each")
    parser.add_argument("--short", action="store_true", help="short recordings")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="keep recordings and findings there")


def _picked(parser: argparse.ArgumentParser, what: str, wanted: str | None, known: Sequence[str]) -> list[str]:
    """The names of a comma-separated list; all known names without a list."""
    names = wanted.split(",") if wanted else list(known)
    if unknown := sorted(set(names) - set(known)):
        parser.error(f"no {what} is called {', '.join(unknown)}; there are {', '.join(known)}")
    return names


def _print_rows(rows: Iterator, header: str, summary: Callable[[list], str], to_json: Path | None) -> None:
    """Print each row when it is done, then the summary, and write the JSON file."""
    print(header, flush=True)
    printed = []
    for row in rows:
        print(row.text(), flush=True)
        printed.append(row)
    print(summary(printed))
    if to_json:
        to_json.write_text(json.dumps([row.as_dict() for row in printed], indent=2) + "\n", encoding="utf-8")


@contextlib.contextmanager
def _folder(wanted: Path | None) -> Iterator[Path]:
    """The folder of the recordings; a temporary one when none is given."""
    if wanted is not None:
        wanted.mkdir(parents=True, exist_ok=True)
        yield wanted
        return
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


if __name__ == "__main__":
    main()
