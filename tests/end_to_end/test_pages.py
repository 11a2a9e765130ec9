"""Every report in a real browser: nothing from elsewhere, nothing wider than a telephone, A4 on paper, 3 MB at most."""

import re
import shutil
import signal
import time

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.model import load_model
from piezod.recording import Recording, read_recording, write_recording
from piezod.report.diagnosis.page import write_diagnosis_page
from piezod.report.identification import write_identification_page
from piezod.report.run import run_figures, write_run_page
from piezod.report.tracking.validation import evaluate_validation, write_validation_page
from piezod.session.task import Outcome
from tests.benches.browser import chromium, open_page
from tests.benches.daemon import WITHIN_S, daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.unit.report.example_diagnosis import diagnosis

LIMIT_BYTES = 3_000_000
A4_POINTS = (594.96, 841.92)
MODEL = shipped("model.yaml")


def work(seconds=40.0, noise_N=0.2):
    """The shipped model driven by loops that become smaller, read with noise."""
    time_s = np.arange(0.0, seconds, 5e-3)
    voltage_V = 60.0 * (1.0 - np.cos(0.5 * np.pi * time_s)) * (1.0 - 0.8 * time_s / seconds)
    force_N = load_model(MODEL).operator().run(voltage_V)
    force_N += noise_N * np.random.default_rng(3).standard_normal(time_s.size)
    return Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N}, {}, "work.csv")


def long_run():
    """An hour at a kilohertz, as the recorder keeps it."""
    size = 3_600_000
    rng = np.random.default_rng(4)
    reference = 150.0 + 100.0 * np.sin(np.arange(size) * 1e-3)
    channels = {
        "voltage_V": reference / 2.0,
        "reference_N": reference,
        "force_N": reference + 0.2 * rng.standard_normal(size),
        "temperature_C": 22.0 + 0.1 * rng.standard_normal(size),
        "tick": np.arange(size, dtype=float),
        "state": np.full(size, 2.0),
        "cause": np.full(size, 2.0),
        "lateness_ns": rng.exponential(2e4, size),
        "exchange_ns": rng.exponential(1e5, size),
    }
    return Recording(np.arange(size) * 1e-3, channels, {}, "press-000001.sqlite")


class Triangle:
    """What a validation follows."""

    amplitude_N, offset_N, frequency_Hz = 50.0, 100.0, 0.5


def write_run(folder):
    recording = long_run()
    write_run_page(folder / "page.html", recording, run_figures(recording))


def write_identification(folder):
    recording = work()
    made = identify([recording], Options(plays=4, zones=1), "piezod")
    write_identification_page(folder / "page.html", made, [recording])


def write_validation(folder):
    recordings = {}
    names = [f"{100 + 10 * k} +- 50 N" for k in range(6)]
    compensations = ["without", "constant-triangles", "varying-triangles", "staircase-minor-loops-multisine"]
    time_s = np.arange(0.0, 6.0, 1e-3)
    for k, name in enumerate(names):
        reference = 100.0 + 10 * k + 50.0 * (2.0 * np.abs(time_s % 2.0 - 1.0) - 1.0)
        for n, compensation in enumerate(compensations):
            lag = 30 // (1 + n)
            channels = {"reference_N": reference, "force_N": np.roll(reference, lag)}
            recordings[name, compensation] = Recording(time_s, channels)
    verdict = evaluate_validation(dict.fromkeys(names, Triangle), compensations, (40.0, 260.0), recordings, Outcome())
    write_validation_page(folder / "page.html", verdict, recordings)


def write_diagnosis(folder):
    write_diagnosis_page(folder / "page.html", diagnosis())


def write_comparison(folder):
    write_recording(work(), folder / "work.csv")
    done = piezod("compare", folder / "work.csv", "--model", MODEL, "--report", folder / "page.html")
    assert done.returncode == 0, done.stderr


def write_residual(folder):
    write_recording(work(), folder / "work.csv")
    done = piezod("resid", folder / "work.csv", "--model", MODEL, "--report", folder / "page.html")
    assert done.returncode == 0, done.stderr


PAGES = (write_run, write_identification, write_validation, write_diagnosis, write_comparison, write_residual)


@pytest.fixture(scope="module", params=PAGES, ids=lambda write: write.__name__.removeprefix("write_"))
def page(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    request.param(folder)
    return folder / "page.html"


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


def drawn(opened):
    """Every figure has drawn itself."""
    opened.wait_for_function("() => typeof Bokeh !== 'undefined' && Bokeh.documents.length > 0")
    opened.wait_for_function("() => Bokeh.documents.every((one) => one.is_idle)")
    return opened.evaluate("() => Bokeh.documents.reduce((sum, one) => sum + one.roots().length, 0)")


@pytest.fixture(scope="module")
def on_desktop(page, browser):
    """The page without a network, its errors, and the addresses that it asked for."""
    asked = []
    opened, errors = open_page(browser, page.as_uri(), requests=asked, offline=True)
    yield opened, errors, asked
    opened.close()


def test_a_page_stays_within_its_size_limit(page):
    assert page.stat().st_size <= LIMIT_BYTES


@pytest.mark.parametrize("viewport", ["desktop", "telephone"])
def test_a_page_draws_itself_offline_and_fits_its_screen(page, browser, on_desktop, viewport):
    opened, errors, asked = on_desktop
    if viewport != "desktop":
        asked = []
        opened, errors = open_page(browser, page.as_uri(), viewport, asked, offline=True)
    assert drawn(opened) > 0
    assert errors == []
    assert page.as_uri() in asked
    assert [address for address in asked if not address.startswith(("file:", "data:", "blob:"))] == []
    assert opened.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    if viewport != "desktop":
        opened.close()


def test_every_figure_has_its_data_beside_the_page(page, on_desktop):
    figures = drawn(on_desktop[0])
    own = sorted(page.parent.glob("figures/*.csv"))  # the diagnosis names its own, some for two figures
    files = own or sorted(page.parent.glob("page.data/*.csv"))
    assert own or len(files) == figures
    assert all(len(path.read_text(encoding="utf-8").splitlines()) > 1 for path in files)


def test_a_page_prints_to_a4(on_desktop, tmp_path):
    opened, _, _ = on_desktop
    drawn(opened)
    opened.pdf(path=tmp_path / "page.pdf", prefer_css_page_size=True)
    sheets = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", (tmp_path / "page.pdf").read_bytes())
    assert 1 <= len(sheets) <= 12
    for sheet in sheets:
        assert tuple(map(float, sheet)) == pytest.approx(A4_POINTS, abs=1.0)


def test_a_run_that_was_cut_off_has_its_report(tmp_path, browser):
    """The daemon is killed while it drives; what lies on the disk at that moment is copied and reported."""
    never = {"comm_loss_ms": 9000, "device_watchdog_ms": 8000, "stale_after_ms": 4000, "missed_ticks_in_a_row": 2000}
    with emulator("--port", "0") as serves:
        bench = bench_file(
            tmp_path,
            serves,
            rate_Hz=100,
            limits=never,
            arming={"voltage_V_per_s": 800.0, "reset_cycle": False},
            recorder={"folder": str(tmp_path / "kept"), "sync_every_s": 0.1},
        )
        with daemon(bench) as service:
            service.connected()
            assert service.tell("arm")["state"] == "RUNNING"
            time.sleep(1.5)
            shutil.copytree(tmp_path / "kept", tmp_path / "as it was")
            service.signal(signal.SIGKILL)
            service.process.wait(timeout=WITHIN_S)
    (recording,) = (tmp_path / "as it was").glob("*.sqlite")
    done = piezod("report", recording, "-o", tmp_path / "run.html")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("interrupted in RUNNING: ")
    opened, errors = open_page(browser, (tmp_path / "run.html").as_uri())
    assert drawn(opened) >= 4
    assert errors == []
    assert read_recording(recording).time_s.size > 50
    opened.close()
