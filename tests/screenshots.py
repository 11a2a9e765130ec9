"""Screenshots for the README: `python -m tests.screenshots` runs an emulated bench and saves its pages as pictures.

It needs chromium and playwright. It takes some minutes, mainly for identification and diagnosis.
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import yaml
from PIL import Image

from tests.benches.browser import VIEWPORTS, chromium
from tests.benches.daemon import LONG_LIMITS, daemon
from tests.benches.emulator import EMULATOR, bench_file, emulator

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / ".screenshots"
COLOURS = 256  # of a palette that includes rare colours; it makes the files small
LIMIT_BYTES = 200_000
RATE_HZ = 100  # low enough for any machine
RUN_S = 35.0  # longer than the 30 s that the curves show
LAG_AND_CREEP = {"electrical_lag": {"time_constant_s": 0.004}, "creep": {"per_decade": 0.013}}
MOST_PIXELS = 1700  # height of a picture; a longer page is cropped


def main() -> None:
    """Save every picture, or only the named pictures."""
    parser = argparse.ArgumentParser(prog="python -m tests.screenshots", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, []], help="default: all")
    names = parser.parse_args().names or list(PICTURES)
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for name in names:
            PICTURES[name](browser, Path(folder))


def live(browser, folder: Path) -> None:
    """The live page of a running bench, on a desktop and on a telephone. The run is recorded for `run`."""
    with _running(folder) as (bench, _), _watch(bench) as address:
        time.sleep(RUN_S)
        for viewport, name in (("desktop", "live"), ("telephone", "live-telephone")):
            page = _open(browser, address, viewport)
            page.get_by_text("RUNNING", exact=True).first.wait_for()
            page.wait_for_timeout(1500)
            _save_picture(page, name, whole=True)


def run(browser, folder: Path) -> None:
    """The page of a run."""
    if not (folder / "recordings").is_dir():
        with _running(folder):
            time.sleep(RUN_S)
    recording = max((folder / "recordings").glob("*.sqlite"))
    _piezod("report", recording, "-o", folder / "run.html")
    _save_picture(_open(browser, (folder / "run.html").as_uri()), "run")


def commission(browser, folder: Path) -> None:
    """The pages of identification and validation, from one commissioning."""
    _commissioned(folder)
    identified = folder / "seed" / "varying-triangles" / "identification.html"
    _save_picture(_open(browser, identified.as_uri()), "identification")
    _save_picture(_open(browser, (folder / "seed" / "validation.html").as_uri()), "validation")


def diagnosis(browser, folder: Path) -> None:
    """The page of a diagnosis. The bench has a lag and a creep that its model lacks."""
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"effects": LAG_AND_CREEP}
    changed = folder / "changed.yaml"
    changed.write_text(yaml.safe_dump(content), encoding="utf-8")
    work = folder / "work.csv"
    with emulator("--port", "0", "--time", "virtual", config=changed) as serves:
        bench = bench_file(folder, serves, rate_Hz=200, limits=LONG_LIMITS)
        _piezod("record", bench, "--excitation", "staircase-minor-loops-multisine", "-o", work)
    _piezod("diagnose", work, "--model", ROOT / "config" / "model.yaml", "-o", folder / "diagnosis")
    _save_picture(_open(browser, (folder / "diagnosis" / "report.html").as_uri()), "diagnosis")


PICTURES = {"live": live, "run": run, "commission": commission, "diagnosis": diagnosis}


@contextlib.contextmanager
def _running(folder: Path) -> Iterator[tuple[Path, object]]:
    """Run a daemon that follows triangles and records them; yields its bench file and the daemon."""
    with emulator("--port", "0") as serves:
        bench = bench_file(
            folder,
            serves,
            rate_Hz=RATE_HZ,
            limits=LONG_LIMITS,
            arming={"voltage_V_per_s": 400.0},
            reference={"frequency_Hz": 0.2},
            recorder={"folder": str(folder / "recordings")},
        )
        with daemon(bench) as service:
            service.connected()
            service.tell("arm")
            yield bench, service
            service.tell("disarm")


@contextlib.contextmanager
def _watch(bench: Path) -> Iterator[str]:
    """Serve the live page; yields its address."""
    command = [sys.executable, "-m", "piezod", "watch", str(bench), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[2]
    finally:
        os.kill(process.pid, signal.SIGTERM)
        process.wait()


def _commissioned(folder: Path) -> None:
    if not (folder / "seed" / "validation.html").exists():
        _piezod("commission", "--emulated", "seed_bench", "-o", folder / "seed")


def _piezod(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "piezod", *map(str, arguments)], check=True)


def _open(browser, address: str, viewport: str = "desktop"):
    width, height = VIEWPORTS[viewport]
    page = browser.new_page(viewport={"width": width, "height": height})
    page.goto(address)
    page.wait_for_function("() => Bokeh.documents.length > 0 && Bokeh.documents.every((one) => one.is_idle)")
    page.wait_for_timeout(1000)
    return page


def _save_picture(page, name: str, *, whole: bool = False) -> None:
    """Save the visible part of a page, or the whole page, as a small PNG file."""
    path = FOLDER / f"{name}.png"
    page.screenshot(path=path, full_page=whole)
    with Image.open(path) as picture:
        shown = picture.crop((0, 0, picture.width, min(picture.height, MOST_PIXELS)))
        shown.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            path, optimize=True
        )
    assert path.stat().st_size <= LIMIT_BYTES, f"{path} has {path.stat().st_size} bytes, at most {LIMIT_BYTES}"
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1000} kB")
    page.close()


if __name__ == "__main__":
    main()
