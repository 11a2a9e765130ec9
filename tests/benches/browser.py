"""A real browser without a window: Debian's chromium, driven by playwright."""

import contextlib
import shutil

import pytest

VIEWPORTS = {"desktop": (1280, 900), "telephone": (390, 844)}


@contextlib.contextmanager
def chromium():
    """Start it, yield it, end it; without one the test is skipped, saying so."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no chromium here: apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


def open_page(browser, address, viewport="desktop", requests=None, **options):
    """A page, and its errors; `requests` receives the addresses that it asks for."""
    width, height = VIEWPORTS[viewport]
    page = browser.new_page(viewport={"width": width, "height": height}, **options)
    page.set_default_timeout(60_000)  # however busy the machine is
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: None if requests is None else requests.append(request.url))
    page.goto(address)
    return page, errors
