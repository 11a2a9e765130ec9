"""The live page in a real browser, beside a running daemon and an emulated bench."""

import contextlib
import http.client
import signal
import socket
import subprocess
import sys
import time

import pytest

from piezod import __version__
from piezod.control import RingReader, State
from tests.benches.browser import chromium, open_page
from tests.benches.daemon import LONG_LIMITS, WITHIN_S, change, daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.processes import Popen

NEWEST = """() => Bokeh.documents[0].get_model_by_name("force").renderers[0].data_source.data.time_ms.at(-1)"""

WINDOW = """Bokeh.documents[0].get_model_by_name("force").x_range"""


@contextlib.contextmanager
def watch(bench, *options):
    """`piezod watch` on a free port: yields the process and its address."""
    port = () if "--port" in options else ("--port", "0")
    command = [sys.executable, "-m", "piezod", "watch", str(bench), *port, *options]
    process = Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        assert line.startswith("live page: http://127.0.0.1:"), line
        yield process, line.split()[2]
    finally:
        process.send_signal(signal.SIGTERM)
        process.send_signal(signal.SIGCONT)
        code = process.wait(timeout=WITHIN_S)
        process.stdout.close()
    assert code == 0


@pytest.fixture
def serves():
    with emulator("--port", "0") as served:
        yield served


@pytest.fixture
def bench(serves, tmp_path):
    return bench_file(
        tmp_path,
        serves,
        rate_Hz=100,
        limits=LONG_LIMITS,
        arming={"voltage_V_per_s": 800.0, "reset_cycle": False},
        reference={"frequency_Hz": 0.5},
    )


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


def shows(page, words):
    page.get_by_text(words, exact=True).first.wait_for()


def streams(page):
    """The newest point that is drawn moves on."""
    page.wait_for_function(f"() => Number.isFinite(({NEWEST})())")
    before = page.evaluate(NEWEST)
    page.wait_for_function(f"(before) => ({NEWEST})() > before + 200", arg=before)


def test_the_page_shows_a_running_bench_and_streams(bench, browser):
    with daemon(bench) as service, watch(bench) as (_, address):
        service.connected()
        page, errors = open_page(browser, address)
        shows(page, "DISARMED")
        assert service.tell("arm")["state"] == "RUNNING"
        shows(page, "RUNNING")
        streams(page)
        page.wait_for_function(
            """() => Bokeh.documents[0].get_model_by_name("curve").renderers[0].data_source.data.force_N.length > 100"""
        )
        assert page.title() == "RUNNING: emulator"
        assert errors == []
        assert page.locator("#stale").is_hidden()
        page.close()


def test_a_zoomed_page_stands_still_until_it_is_reset(bench, browser):
    with daemon(bench) as service, watch(bench) as (_, address):
        service.connected()
        page, errors = open_page(browser, address)
        service.tell("arm")
        shows(page, "RUNNING")
        streams(page)
        page.get_by_text(f"model model.yaml · 100 Hz · piezod {__version__} · up").wait_for()
        box = page.locator("figure").first.bounding_box()
        page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 120)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 140, steps=5)
        page.mouse.up()
        page.wait_for_function(f"() => {WINDOW}.end - {WINDOW}.start < 10_000")
        page.wait_for_timeout(1000)
        shown = page.evaluate(f"() => {WINDOW}.end")
        page.wait_for_timeout(1000)
        assert page.evaluate(f"() => {WINDOW}.end") == shown
        page.get_by_title("Reset").first.click()
        page.wait_for_function(f"() => {WINDOW}.end - {WINDOW}.start > 20_000")
        streams(page)
        assert errors == []
        page.close()


def test_nothing_on_a_telephone_is_wider_than_its_screen(bench, browser):
    with daemon(bench) as service, watch(bench) as (_, address):
        service.connected()
        page, errors = open_page(browser, address, "telephone")
        shows(page, "DISARMED")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert errors == []
        page.close()


def latched_ms(bench):
    """When the loop latched the fault, as the page's clock has it."""
    reader = RingReader(bench.parent / "ring")
    rows = reader.read()
    row = rows[rows["state"] == State.FAULT][0]
    return row["time_ns"] * 1e-6 + (time.time_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)) * 1e-6


@pytest.mark.slow
def test_a_fault_is_on_the_screen_before_the_curves_have_gone_on_for_a_second(bench, browser):
    """In the time of the curves: a starved machine may show everything late, but not the fault later than the rest."""
    with daemon(bench) as service, watch(bench) as (_, address):
        service.connected()
        page, _ = open_page(browser, address)
        service.tell("arm")
        shows(page, "RUNNING")
        streams(page)
        change(bench, "force_trip_N: 360.0", "force_trip_N: 30.0")
        service.tell("reload")
        page.wait_for_function("() => document.title.startsWith('FAULT')", polling=20)
        drawn_ms = page.evaluate(NEWEST) - 1000 * time.localtime().tm_gmtoff
        assert drawn_ms - latched_ms(bench) < 1000
        shows(page, "force above limits.force_trip_N")
        shows(page, "check specimen, reference and load cell; then piezod reset")
        page.close()
        assert service.end() == 1


def test_the_page_goes_on_when_the_daemon_was_killed_and_started_again(bench, browser):
    with watch(bench) as (_, address):
        page, errors = open_page(browser, address)
        shows(page, "STALE")
        with daemon(bench) as service:
            service.connected()
            shows(page, "DISARMED")
            service.signal(signal.SIGKILL)
            service.process.wait(timeout=WITHIN_S)
        shows(page, "STALE")
        time.sleep(2.5)  # the control process ends by itself
        with daemon(bench) as service:
            service.connected()
            shows(page, "DISARMED")
            streams(page)
            shows(page, "the daemon was started again")
        assert errors == []
        page.close()


def test_a_page_whose_server_is_gone_says_so_and_comes_back_with_it(bench, browser):
    with daemon(bench) as service:
        service.connected()
        with watch(bench) as (process, address):
            page, _ = open_page(browser, address)
            shows(page, "DISARMED")
            process.send_signal(signal.SIGSTOP)
            page.get_by_text("the values are out of date").wait_for()
            process.send_signal(signal.SIGCONT)
            page.locator("#stale").wait_for(state="hidden")
            streams(page)
        page.get_by_text("the values are out of date").wait_for()
        port = address.rstrip("/").rpartition(":")[2]
        with watch(bench, "--port", port):
            page.locator("#stale").wait_for(state="hidden")
            shows(page, "DISARMED")
            page.close()


@pytest.mark.slow
def test_no_viewer_and_no_companion_holds_a_tick_up(bench, browser):
    """Both stand still, stopped in the middle of whatever they did; the loop ticks on."""
    with daemon(bench) as service, watch(bench) as (process, address):
        service.connected()
        pages = [open_page(browser, address)[0] for _ in range(3)]
        for page in pages:
            shows(page, "DISARMED")
        process.send_signal(signal.SIGSTOP)
        before = service.status()
        time.sleep(2.0)
        after = service.status()
        assert after["ticks"] > before["ticks"]
        assert after["state"] == "DISARMED"
        process.send_signal(signal.SIGCONT)
        for page in pages:
            streams(page)
            page.close()


def test_commands_are_taken_from_whoever_has_the_token_and_from_nobody_else(bench, browser, tmp_path):
    token = tmp_path / "token"
    token.write_text("correct horse battery\n", encoding="utf-8")
    token.chmod(0o600)
    with daemon(bench) as service, watch(bench, "--token-file", str(token)) as (_, address):
        service.connected()
        page, _ = open_page(browser, address)
        shows(page, "DISARMED")
        page.get_by_role("button", name="disarm").wait_for()
        page.get_by_placeholder("token").fill("wrong horse battery")
        page.get_by_role("button", name="arm", exact=True).click()
        page.get_by_text("refused: wrong token").wait_for()
        assert service.status()["state"] == "DISARMED"
        time.sleep(1.2)
        page.get_by_placeholder("token").fill("correct horse battery")
        page.get_by_placeholder("token").press("Tab")
        page.get_by_role("button", name="arm", exact=True).click()
        shows(page, "RUNNING")
        page.get_by_role("button", name="disarm").click()
        shows(page, "DISARMED")
        page.close()
    assert any("socket: arm by uid" in line for line in service.said)


def test_without_a_token_there_is_nothing_to_press(bench, browser):
    with daemon(bench) as service, watch(bench) as (_, address):
        service.connected()
        page, _ = open_page(browser, address)
        shows(page, "DISARMED")
        assert page.get_by_role("button").count() == 0
        page.close()


@pytest.mark.parametrize(("origin", "refused"), [("http://elsewhere.example", True), ("own", False)])
def test_a_page_of_another_origin_is_not_let_in(bench, origin, refused):
    with watch(bench) as (_, address):
        host = address.removeprefix("http://").rstrip("/")
        wanted = f"http://{host}" if origin == "own" else origin
        lines = (
            "GET /ws HTTP/1.1",
            f"Host: {host}",
            f"Origin: {wanted}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        )
        with socket.create_connection(("127.0.0.1", int(host.rpartition(":")[2])), timeout=WITHIN_S) as connection:
            connection.sendall("\r\n".join((*lines, "", "")).encode())
            answer = connection.recv(4096)
    assert answer.startswith(b"HTTP/1.1 403") == refused, answer


def test_a_port_that_is_taken_is_one_line(bench):
    with watch(bench) as (_, address):
        port = address.rstrip("/").rpartition(":")[2]
        done = piezod("watch", bench, "--port", port)
    assert done.returncode == 75
    assert done.stderr.strip() == f"piezod: --port is {port}, 127.0.0.1:{port} is taken; name another, or 0"


def answer(address, path="/", **headers):
    """Status and headers of a request to the live page."""
    port = int(address.split(":")[2].strip("/"))
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status, response.headers


UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "MDEyMzQ1Njc4OWFiY2RlZg==",
}


def test_the_page_answers_only_under_its_names_and_to_itself(bench):
    with watch(bench, "--host", "press.example") as (_, address):
        port = address.split(":")[2].strip("/")
        for host in (f"127.0.0.1:{port}", f"localhost:{port}", "localhost:8080", "press.example", "PRESS.example:443"):
            assert answer(address, Host=host)[0] == 200, host
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", "", "x@localhost", "0.0.0.0"):
            for path in ("/", "/autoload.js?bokeh-autoload-element=1", "/ws", "/static/js/bokeh.min.js"):
                assert answer(address, path, Host=host)[0] in (400, 403), (host, path)
        for origin in ("http://evil.example", f"http://localhost:{int(port) + 1}", "null", f"http://127.0.0.1:{port}"):
            status, _ = answer(address, "/ws", Host=f"localhost:{port}", Origin=origin, **UPGRADE)
            assert status == 403, origin


def test_no_other_page_can_show_the_page_in_a_frame_or_read_it(bench):
    with watch(bench) as (_, address):
        for path in ("/", "/autoload.js?bokeh-autoload-element=1", "/static/js/bokeh.min.js", "/nothing"):
            _, headers = answer(address, path)
            assert "frame-ancestors 'none'" in headers["Content-Security-Policy"], path
            assert "default-src 'none'" in headers["Content-Security-Policy"]
            assert headers["X-Frame-Options"] == "DENY"
            assert headers["Access-Control-Allow-Origin"] is None
