"""The recorder under kills, power cuts, and full, failing or slow disks: no acknowledged row may be lost.

A row is acknowledged when the recorder reports on its pipe that the row is on the disk. Afterwards its files are read,
and every row is compared with the row written to the ring log.
"""

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from piezod.recorder.messages import Plan
from tests.benches.recorded_blocks import begun_files, read_blocks
from tests.studies.feed import Comparison, Feed, RecorderProcess, compare
from tests.studies.powercut import cannot_cut, cannot_mount, disk, fill, small_folder
from tests.studies.served import Served, served

SEED = 7
WHILE_WRITING = 0.8  # share of the kills; the others hit the start
SYNC_S = 0.05  # a tenth of the default, so that many kills hit a commit
_LINE = "{what:<34} {times:>6} {acknowledged:>13} {kept:>9} {lost:>5} {twice:>6} {wrong:>6}  {note}"


@dataclass(frozen=True)
class Line:
    """One row of the table.

    Parameters
    ----------
    what, times
        Description and number of repetitions.
    acknowledged, kept, lost, twice, wrong
        Numbers of rows: acknowledged; present; acknowledged but missing; present twice; not as written.
    note
        Further observations.
    failed
        Whether the result is wrong.
    skipped
        Reason why it was skipped; empty otherwise.
    """

    what: str
    times: int = 0
    acknowledged: int = 0
    kept: int = 0
    lost: int = 0
    twice: int = 0
    wrong: int = 0
    note: str = ""
    failed: bool = False
    skipped: str = ""

    def text(self) -> str:
        """One line."""
        if self.skipped:
            return f"{self.what:<34} SKIPPED: {self.skipped}"
        return _LINE.format(**asdict(self)) + ("  FAILED" if self.failed else "")


def header() -> str:
    """The header line."""
    return _LINE.format(**{name: name for name in ("what", "times", "acknowledged", "kept", "lost", "twice", "wrong", "note")})  # fmt: skip  # noqa: E501


def kills(folder: Path, times: int) -> Iterator[Line]:
    """SIGKILL at random times; the next recorder continues. At the end no row may be missing."""
    draw = random.Random(SEED)
    lost = twice = wrong = acknowledged = beyond = 0
    plan = _plan(folder / "kept")
    with Feed(folder / "ring") as feed:
        for _ in range(times):
            with RecorderProcess(plan, feed.path) as recorder:
                if draw.random() < WHILE_WRITING:
                    recorder.wait_for(lambda report: report.rows > 0)
                time.sleep(draw.uniform(0.0, 1.0))
                acknowledged = max(acknowledged, recorder.kill().row)
            found = compare(folder / "kept", plan.bench, acknowledged)
            lost, twice, wrong = max(lost, found.lost), max(twice, found.twice), wrong + found.wrong + found.damaged
            beyond += found.rows > acknowledged
        with RecorderProcess(plan, feed.path) as recorder:
            recorder.wait_for(lambda report: report.rows > 0)
            written = feed.close()
            dropped = recorder.end().dropped
    found = compare(folder / "kept", plan.bench, written)
    note = (
        f"{beyond} between commit and report; at the end {found.lost} of {written} written missing, {found.files} files"
    )
    bad = bool(lost or twice or wrong or dropped or not found.sound)
    yield Line("SIGKILL of the recorder", times, acknowledged, found.rows, lost, twice, wrong, note, bad)


def daemon_kills(folder: Path, times: int) -> Iterator[Line]:
    """SIGKILL of the daemon while driving; the files must hold the rows that its status reported."""
    draw = random.Random(SEED)
    lost = acknowledged = rows = after = 0
    for k in range(times):
        place = folder / f"daemon{k}"
        with served(place, {"folder": str(place / "kept"), "sync_every_s": 0.1}) as daemon:
            daemon.command("arm")
            daemon.wait_until(lambda status: status["recorder"]["rows"] > 0)
            time.sleep(draw.uniform(0.1, 1.0))
            status = daemon.status()["recorder"]
            os.kill(daemon.process.pid, signal.SIGKILL)
            daemon.process.wait()
            kept = _recorded_ticks(place / "kept")
            lost += max(0, status["rows"] - sum(tick <= status["last_tick"] for tick, _ in kept))
            acknowledged += status["rows"]
            _wait_for_quiet(place / "kept")
            kept = _recorded_ticks(place / "kept")
            rows += len(kept)
            after += kept[-1][1] == 0  # DISARMED: the ramp down is recorded
    note = f"in {after} of {times} the ramp down after the kill is recorded to its end"
    yield Line("SIGKILL of the daemon", times, acknowledged, rows, lost, 0, 0, note, bool(lost or after < times))


def _recorded_ticks(folder: Path) -> list[tuple[int, int]]:
    """(tick, state) of every row, in order."""
    blocks = [block for path in begun_files(folder, "emulator") for block in read_blocks(path)[1]]
    return [(int(row["tick"]), int(row["state"])) for block in blocks for row in block.rows]


def _wait_for_quiet(folder: Path) -> None:
    """Wait until the orphaned recorder has ended and its -wal file is gone."""
    deadline_s = time.monotonic() + 30.0
    while any(folder.glob("*-wal")) and time.monotonic() < deadline_s:
        time.sleep(0.1)


def cuts(folder: Path, times: int) -> Iterator[Line]:
    """Cut the power of the disk at random times; an unsynced CSV file shows that a cut loses data."""
    what = "power cut, ext4 on a loop device"
    if why := cannot_cut():
        yield Line(what, skipped=f"{why}; the kills do not test this, since the memory survives them")
        return
    draw = random.Random(SEED)
    with disk(folder) as cut_disk, Feed(folder / "ring") as feed:
        plan = _plan(cut_disk.root / "kept")
        worst, lost, acknowledged = Comparison(), 0, 0
        for _ in range(times):
            with RecorderProcess(plan, feed.path) as recorder:
                recorder.wait_for(lambda report: report.rows > 0)
                time.sleep(draw.uniform(0.0, 1.0))
                cut_s = time.monotonic()
                cut_disk.cut()
                time.sleep(3 * SYNC_S)  # reports after the cut do not count
                recorder.kill()
                acknowledged = max(acknowledged, recorder.acknowledged(cut_s))
            cut_disk.restore()
            worst = compare(cut_disk.root / "kept", plan.bench, acknowledged)
            lost = max(lost, worst.lost)
        bad = bool(lost or not worst.sound)
        note = f"{worst.files} files"
        yield Line(what, times, acknowledged, worst.rows, lost, worst.twice, worst.wrong, note, bad)
        written, left = _unsynced(cut_disk.root / "unsynced", cut_disk.cut, cut_disk.restore)
        note = "shows that a cut loses unsynced data"
        yield Line("the same, a CSV without fsync", 1, written, left, written - left, 0, 0, note, left == written)


def _unsynced(path: Path, cut: Callable[[], None], restore: Callable[[], None]) -> tuple[int, int]:
    """Number of rows written and flushed, and number of those present after a cut."""
    with path.open("w", encoding="ascii") as file:
        for k in range(1000):
            file.write(f"{k},1.0\n")
        file.flush()
        cut()
    restore()
    return 1000, path.read_text(encoding="ascii").count("\n") if path.exists() else 0


FAULTS = {
    "EIO at every 20th sync": ("fdatasync,fsync", "error=EIO:when=20+20"),
    "EIO at every 400th write": ("pwrite64", "error=EIO:when=200+400"),
    "ENOSPC at every 400th write": ("pwrite64", "error=ENOSPC:when=200+400"),
    "every 20th sync takes 5 s": ("fdatasync", "delay_enter=5000000:when=20+20"),
}


def faults(folder: Path, seconds: float) -> Iterator[Line]:
    """System calls that fail or hang, by strace."""
    for number, (what, (calls, how)) in enumerate(FAULTS.items()):
        if shutil.which("strace") is None:
            yield Line(what, skipped="needs strace")
            continue
        place = folder / f"fault{number}"
        place.mkdir()
        plan = _plan(place / "kept")
        inject = ("strace", "-f", "-qq", "-o", os.devnull, "-e", f"trace={calls}", "-e", f"inject={calls}:{how}")
        with (
            Feed(place / "ring", capacity=30_000) as feed,
            RecorderProcess(plan, feed.path, *inject) as recorder,
        ):
            recorder.wait_for(lambda report: report.rows > 0)
            time.sleep(seconds)
            acknowledged = recorder.kill().row
            written = feed.close()
        found = compare(place / "kept", plan.bench, acknowledged)
        last = recorder.last
        slow = "delay" in how
        hit = recorder.worst_commit_s > 4.0 if slow else last.failures > 0
        note = f"{last.failures} files abandoned, {last.dropped} rows dropped, "
        note += f"{written - acknowledged} not acknowledged at the end; "
        note += f"slowest commit {recorder.worst_commit_s:.1f} s" if slow else f"{(recorder.problems or ['-'])[0]:.70}"
        bad = bool(found.lost or found.wrong or found.damaged or not hit or last.dropped)
        yield Line(what, 1, acknowledged, found.rows, found.lost, found.twice, found.wrong, note, bad)


def full(folder: Path, seconds: float, rounds: int) -> Iterator[Line]:
    """The control loop at 1 kHz without a recorder, with a recorder, and with a full disk, in turn."""
    if why := cannot_mount():
        yield Line("a full disk", skipped=why)
        return
    counted: dict[str, list[int]] = {"off": [], "on": [], "full": []}
    ticks = dict.fromkeys(counted, 0)
    notes = dict.fromkeys(counted, "")
    failed = False
    for k in range(rounds):
        for mode, missed_ticks in counted.items():
            place = folder / f"{mode}{k}"
            place.mkdir()
            with small_folder(place / "small", 32.0) as small:
                section = None if mode == "off" else {"folder": str(small / "kept"), "file_MB": 8, "folder_MB": 16}
                with served(place, section) as daemon:
                    ran, missed, notes[mode], bad = _drive(daemon, small if mode == "full" else None, seconds)
            missed_ticks.append(missed)
            ticks[mode] += ran
            failed = failed or bad
    for mode, missed in counted.items():
        names = {"off": "no recorder", "on": "recorder", "full": "recorder, full disk"}
        note = (
            f"missed {sum(missed)} of {ticks[mode] + sum(missed)} ticks, in each round {min(missed)} to {max(missed)}, "
            f"median {statistics.median(missed):g}; {notes[mode]}"
        )
        yield Line(f"1 kHz, {names[mode]}", rounds, note=note, failed=failed and mode == "full")


def _drive(daemon: Served, full_disk: Path | None, seconds: float) -> tuple[int, int, str, bool]:
    """Drive for `seconds`; returns (ticks, missed ticks, note, whether the result is wrong)."""
    daemon.command("arm")
    ballast = None
    if full_disk is not None:
        daemon.wait_until(lambda status: status["recorder"]["rows"] > 0)
        ballast = fill(full_disk)
        daemon.wait_until(lambda status: status["recorder"]["degraded"])
    before = daemon.status()
    time.sleep(seconds)
    after = daemon.status()
    ran, missed = (after[key] - before[key] for key in ("ticks", "missed"))
    bad = after["state"] != "RUNNING" or ran == 0
    note = ""
    if ballast is not None:
        status = after["recorder"]
        note = f"'{status['problem'].rpartition(': ')[2]}'"
        bad = bad or not status["degraded"]
        ballast.unlink()
        begun_s = time.monotonic()
        back = daemon.wait_until(lambda status: not status["recorder"]["degraded"])["recorder"]
        note += f", recording again {time.monotonic() - begun_s:.1f} s after space is free, {back['dropped']} lost"
        bad = bad or bool(back["dropped"])
    return ran, missed, note, bad


def cost(folder: Path, seconds: float) -> Iterator[Line]:
    """Processor time and bytes for each tick at 1 kHz, on the emulated bench with default settings."""
    place = folder / "cost"
    with served(place, {"folder": str(place / "kept")}) as daemon:
        daemon.command("arm")
        before = daemon.wait_until(lambda status: status["recorder"]["rows"] > 0)["recorder"]
        commits = []
        deadline_s = time.monotonic() + seconds
        while time.monotonic() < deadline_s:
            time.sleep(0.5)
            commits.append(daemon.status()["recorder"]["commit_s"])
        after = daemon.status()["recorder"]
        resident_kB = _resident_kB(after["pid"])
    rows = after["rows"] - before["rows"]
    size = sum(path.stat().st_size for path in (place / "kept").iterdir())
    ticks = len(_recorded_ticks(place / "kept"))
    note = (
        f"{1e6 * (after['cpu_s'] - before['cpu_s']) / rows:.1f} us of processor time "
        f"and {size / ticks:.1f} bytes for each tick, "
        f"{1e-6 * size / ticks * 3.6e6:.0f} MB/h; commit {1e3 * statistics.median(commits):.1f} ms median, "
        f"{1e3 * max(commits):.1f} ms longest; resident {resident_kB / 1024:.0f} MiB"
    )
    yield Line("cost at 1 kHz", 1, kept=ticks, note=note)


def _resident_kB(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


PARTS = {
    "kills": (lambda folder, short: kills(folder, 8 if short else 100)),
    "daemon_kills": (lambda folder, short: daemon_kills(folder, 1 if short else 10)),
    "cuts": (lambda folder, short: cuts(folder, 4 if short else 20)),
    "faults": (lambda folder, short: faults(folder, 8.0 if short else 30.0)),
    "full": (lambda folder, short: full(folder, 5.0 if short else 10.0, 1 if short else 6)),
    "cost": (lambda folder, short: cost(folder, 5.0 if short else 60.0)),
}


def _plan(folder: Path) -> Plan:
    return Plan(str(folder), "b", SYNC_S, 1e9, 1e9, 1e12)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this study."""
    parser.add_argument("--only", metavar="NAME,...", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--short", action="store_true", help="two minutes instead of ten")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Print the table; exit code 1 when a result is wrong."""
    names = options.only.split(",") if options.only else list(PARTS)
    if unknown := sorted(set(names) - set(PARTS)):
        parser.error(f"no part is called {', '.join(unknown)}; there are {', '.join(PARTS)}")
    print(header(), flush=True)
    lines = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            for line in PARTS[name](Path(folder), options.short):
                print(line.text(), flush=True)
                lines.append(line)
    failed = [line.what for line in lines if line.failed]
    skipped = [line.what for line in lines if line.skipped]
    print(f"{len(lines) - len(failed) - len(skipped)} of {len(lines)} passed, {len(skipped)} skipped")
    if options.json:
        options.json.write_text(json.dumps([asdict(line) for line in lines], indent=2) + "\n", encoding="utf-8")
    if failed:
        parser.exit(1, f"failed: {', '.join(failed)}\n")


if __name__ == "__main__":
    own = argparse.ArgumentParser(prog="python -m tests.studies.recorder", description=__doc__)
    add_options(own)
    given = own.parse_args()
    given.run(given, own)
