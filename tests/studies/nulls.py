"""Identified models in free run on other work, on benches with nothing wrong in them.

python -m tests.studies nulls [--cases 20]

The error is divided by the noise, so a perfect model has 1.
"""

import argparse
import contextlib
import json
import tempfile
import time
import zlib
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from firmware_sim.concealed.study.nulls import FAMILIES, NullBench, draw_null
from piezod.errors import PiezodError
from piezod.estimation.recordings.intake import load_for_simulation, load_recordings
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.identify.simulation import simulate_recording

COLUMNS = "{family:14} {record:22} {bench:16} {ratio:>8} {plays:>5} {zones:>5} {cpu_s:>6}  {said}"


@dataclass
class Row:
    """A bench and its model.

    Parameters
    ----------
    family, record, bench
        As in `NullBench`.
    ratio
        Rms of the free run's error over the noise; None without a model.
    plays, zones
        n and m.
    cpu_s
        Processor time of reading and identification [s].
    said
        The refusal; empty otherwise.
    """

    family: str
    record: str
    bench: str
    ratio: float | None = None
    plays: int = 0
    zones: int = 0
    cpu_s: float = 0.0
    said: str = ""

    def text(self) -> str:
        """The row of the table."""
        shown = asdict(self) | {
            "ratio": "refused" if self.ratio is None else f"{self.ratio:.3f}",
            "cpu_s": f"{self.cpu_s:.1f}",
        }
        return COLUMNS.format(**shown)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--cases", type=int, default=20, help="benches of each family")
    parser.add_argument("--only", choices=FAMILIES, help="one family")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="keep the files and the true forces here")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Draw, identify and simulate; print a row for each bench, then medians and worst."""
    tasks = [(family, k) for family in FAMILIES for k in range(options.cases) if options.only in (None, family)]
    print(COLUMNS.format(**{name: name for name in Row.__dataclass_fields__} | {"ratio": "x noise"}), flush=True)
    rows: list[Row] = []
    with _folder(options.folder) as folder, ProcessPoolExecutor(options.jobs) as workers:
        for row in workers.map(partial(_row, options.seed, folder), tasks):
            rows.append(row)
            print(row.text(), flush=True)
    print("\n".join(summary(rows)))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")


def summary(rows: list[Row]) -> list[str]:
    """Median and worst of each family, record and bench."""
    lines = [f"{'':24} {'cases':>5} {'refused':>7} {'median':>7} {'worst':>7}"]
    for by in ("family", "record", "bench"):
        groups: dict[str, list[Row]] = defaultdict(list)
        for row in rows:
            groups[getattr(row, by)].append(row)
        lines += [_summary_line(name, group) for name, group in groups.items()]
    return [*lines, _summary_line("all", rows)]


def _summary_line(name: str, rows: list[Row]) -> str:
    ratios = [row.ratio for row in rows if row.ratio is not None]
    found = f"{np.median(ratios):7.3f} {max(ratios):7.3f}" if ratios else ""
    return f"{name:24} {len(rows):5} {len(rows) - len(ratios):7} {found}"


@contextlib.contextmanager
def _folder(path: Path | None) -> Iterator[Path]:
    if path is not None:
        path.mkdir(parents=True, exist_ok=True)
        yield path
        return
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def _row(seed: int, folder: Path, task: tuple[str, int]) -> Row:
    family, number = task
    null = draw_null(family, number, np.random.SeedSequence([seed, zlib.crc32(family.encode()), number]))
    place = folder / f"{family}_{number:02}"
    place.mkdir(exist_ok=True)
    (place / "identification.csv").write_text(null.identification, encoding="utf-8")
    (place / "held_out.csv").write_text(null.held_out, encoding="utf-8")
    np.savez(place / "true.npz", true=null.true, floor=null.floor)
    return judged(null, place)


def judged(null: NullBench, place: Path) -> Row:
    """Identify from the first file and simulate the second."""
    row = Row(null.family, null.record, null.bench)
    begun_s = time.process_time()
    try:
        loaded = load_recordings([place / "identification.csv"], "voltage_V", "force_N")
        found = identify([one.recording for one in loaded], Options(), "", sources=[one.source for one in loaded])
        row.cpu_s = time.process_time() - begun_s
        row.plays, row.zones = found.chosen.plays, found.chosen.zones
        output = found.model.output.channel
        other = load_for_simulation(place / "held_out.csv", "voltage_V", output)
        measured = other.recording.channel(output).copy()
        simulated = simulate_recording(found.model, other.recording, 1.0, sha256=other.sha256).recording
    except PiezodError as error:
        row.said = str(error)
        return row
    error = simulated.channel(output) - measured
    unit = abs(float(np.polyfit(null.true, measured, 1)[0]))  # a pound of the file is read in newtons
    row.ratio = float(np.sqrt(np.mean(error**2))) / (null.floor * unit)
    return row
