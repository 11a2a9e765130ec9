"""Pictures and faults of pages: `python -m tests.page_check [PAGE...] [-o FOLDER] [--axe axe.min.js]`.

Without a page, every kind of page that the program writes is made first, on an emulated bench, in some minutes.

Each page is opened at 1280 and at 390 px, light and dark, and printed to A4. The table shows the widest element, errors
of scripts, and, where axe-core is given (`npm install axe-core`), what it finds by impact.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.benches.browser import VIEWPORTS, chromium
from tests.screenshots import commissioned, compared, diagnosed, history_pages, run_page, running, watch

SERIOUS = ("serious", "critical")
SETTLED_MS = 1000
LIVE_S = 20.0  # curves over time are drawn then


def main() -> None:
    """Check pages; exit 1 if one is too wide, has an error or a serious finding."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_check", description=__doc__)
    parser.add_argument("pages", nargs="*", type=Path, help="default: all kinds, made now")
    parser.add_argument("-o", "--output", type=Path, help="folder for pictures and prints")
    parser.add_argument("--axe", type=Path, help="axe.min.js of axe-core")
    options = parser.parse_args()
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
    rules = "" if options.axe is None else options.axe.read_text(encoding="utf-8")
    faults = 0
    print(f"{'page':28}{'form':18}{'width':>6}{'at most':>9}{'errors':>8}  findings")
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        given = ((path.name, path.resolve().as_uri()) for path in options.pages)
        for name, address in given if options.pages else _every_kind(Path(folder)):
            for viewport, size in VIEWPORTS.items():
                for scheme in ("light", "dark"):
                    width, errors, found = _checked(browser, name, address, viewport, scheme, rules, options.output)
                    faults += width > size[0] or errors > 0 or any(found[impact] for impact in SERIOUS)
                    words = ", ".join(f"{count} {impact}" for impact, count in found.items()) or "none"
                    shown = words if rules else "not looked for"
                    print(f"{name:28}{viewport + ', ' + scheme:18}{width:6}{size[0]:9}{errors:8}  {shown}")
    sys.exit(1 if faults else 0)


def _every_kind(folder: Path) -> Iterator[tuple[str, str]]:
    """Name and address of every kind of page."""
    with running(folder) as (bench, _), watch(bench) as address:
        time.sleep(LIVE_S)
        yield "live.html", address
    demo = folder / "demo.html"
    subprocess.run([sys.executable, "-m", "piezod", "demo", "--report", demo], check=True, stdout=subprocess.DEVNULL)
    diagnosis = diagnosed(folder)
    pages = [run_page(folder), demo, diagnosis, *compared(folder), *commissioned(folder), *history_pages(folder)]
    for page in pages:
        yield "diagnosis.html" if page == diagnosis else page.name, page.as_uri()


def _checked(browser, name, address, viewport, scheme, rules, folder):
    """Width of the page [px], number of errors, and findings by impact."""
    width, height = VIEWPORTS[viewport]
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.wait_for_timeout(SETTLED_MS)
    widest = page.evaluate("document.documentElement.scrollWidth")
    if folder is not None:
        page.screenshot(path=folder / f"{Path(name).stem}-{viewport}-{scheme}.png", full_page=True)
        if (viewport, scheme) == ("desktop", "light"):
            page.pdf(path=folder / f"{Path(name).stem}.pdf", format="A4")
    found = Counter()
    if rules:
        page.evaluate(rules)
        for violation in page.evaluate("axe.run()")["violations"]:
            found[violation["impact"]] += len(violation["nodes"])
    page.close()
    return widest, len(errors), found


if __name__ == "__main__":
    main()
