"""Screenshots for the README: `python -m tests.screenshots` runs an emulated bench and saves its pages as pictures.

It needs chromium and playwright. It takes some minutes, mainly for identification and diagnosis.
"""

import argparse
import contextlib
import os
import shutil
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
    with running(folder) as (bench, _), watch(bench) as address:
        time.sleep(RUN_S)
        for viewport, name in (("desktop", "live"), ("telephone", "live-telephone")):
            page = _open(browser, address, viewport)
            page.get_by_text("RUNNING", exact=True).first.wait_for()
            page.wait_for_timeout(1500)
            _save_picture(page, name, whole=True)


def run(browser, folder: Path) -> None:
    """The page of a run."""
    if not (folder / "recordings").is_dir():
        with running(folder):
            time.sleep(RUN_S)
    _save_picture(_open(browser, run_page(folder).as_uri()), "run")


def run_page(folder: Path) -> Path:
    """The page of the last run in `folder/recordings`."""
    recording = max((folder / "recordings").glob("*.sqlite"))
    _piezod("report", recording, "-o", folder / "run.html")
    return folder / "run.html"


def commission(browser, folder: Path) -> None:
    """The pages of identification and validation, from one commissioning."""
    for page in commissioned(folder):
        _save_picture(_open(browser, page.as_uri()), page.stem)


def diagnosis(browser, folder: Path) -> None:
    """The page of a diagnosis. The bench has a lag and a creep that its model lacks."""
    _save_picture(_open(browser, diagnosed(folder).as_uri()), "diagnosis")


def diagnosed(folder: Path) -> Path:
    """Diagnose a bench with a lag and a creep that its model lacks: `folder/diagnosis` from `folder/work.csv`."""
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"effects": LAG_AND_CREEP}
    changed = folder / "changed.yaml"
    changed.write_text(yaml.safe_dump(content), encoding="utf-8")
    work = folder / "work.csv"
    with emulator("--port", "0", "--time", "virtual", config=changed) as serves:
        bench = bench_file(folder, serves, rate_Hz=200, limits=LONG_LIMITS)
        _piezod("record", bench, "--excitation", "staircase-minor-loops-multisine", "-o", work)
    _piezod("diagnose", work, "--model", ROOT / "config" / "model.yaml", "-o", folder / "diagnosis")
    return folder / "diagnosis" / "report.html"


PICTURES = {"live": live, "run": run, "commission": commission, "diagnosis": diagnosis}


@contextlib.contextmanager
def running(folder: Path) -> Iterator[tuple[Path, object]]:
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
def watch(bench: Path) -> Iterator[str]:
    """Serve the live page; yields its address."""
    command = [sys.executable, "-m", "piezod", "watch", str(bench), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[2]
    finally:
        os.kill(process.pid, signal.SIGTERM)
        process.wait()


def commissioned(folder: Path) -> tuple[Path, Path]:
    """The pages of an identification and of the validation, from one commissioning."""
    _piezod("commission", "--emulated", "seed_bench", "-o", folder / "seed")
    return folder / "seed" / "varying-triangles" / "identification.html", folder / "seed" / "validation.html"


def compared(folder: Path) -> tuple[Path, Path]:
    """The pages of a comparison of three models and of a residual test, after `diagnosed`."""
    models = folder / "diagnosis" / "model.yaml", ROOT / "config" / "model.yaml", folder / "few.yaml"
    _piezod("identify", folder / "work.csv", "--plays", "2", "--dead-zones", "1", "-o", models[2])
    given = [option for model in models for option in ("--model", model)]
    _piezod("compare", folder / "work.csv", *given, "--report", folder / "comparison.html")
    _piezod("resid", folder / "work.csv", "--model", models[1], "--report", folder / "residual.html")
    return folder / "comparison.html", folder / "residual.html"


def history_pages(folder: Path) -> tuple[Path, Path]:
    """The pages of two models, and of an archive of one bench, after `diagnosed` and `commissioned`."""
    _piezod("history", ROOT / "config" / "model.yaml", folder / "diagnosis", "-o", folder / "history.html")
    bench, excitation = folder / "archive" / "press", folder / "seed" / "varying-triangles"
    bench.mkdir(parents=True)
    shutil.copy(excitation.with_suffix(".yaml"), bench / "model.yaml")
    shutil.copy(excitation.with_suffix(".csv"), bench)
    _piezod("history", folder / "archive", "-o", folder / "pages", "--jobs", 1)
    return folder / "history.html", folder / "pages" / "fleet.html"


def _piezod(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "piezod", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


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
