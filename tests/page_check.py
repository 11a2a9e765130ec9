"""Pictures and faults of pages: `python -m tests.page_check PAGE... [-o FOLDER] [--axe axe.min.js]`.

Each page is opened at 1280 and at 390 px, light and dark, and printed to A4. The table shows the widest element, errors
of scripts, and, where axe-core is given (`npm install axe-core`), what it finds by impact.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from tests.benches.browser import VIEWPORTS, chromium

SERIOUS = ("serious", "critical")
SETTLED_MS = 1000


def main() -> None:
    """Check pages; exit 1 if one is too wide, has an error or a serious finding."""
    parser = argparse.ArgumentParser(prog="python -m tests.page_check", description=__doc__)
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="folder for pictures and prints")
    parser.add_argument("--axe", type=Path, help="axe.min.js of axe-core")
    options = parser.parse_args()
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
    rules = "" if options.axe is None else options.axe.read_text(encoding="utf-8")
    faults = 0
    print(f"{'page':28}{'form':18}{'width':>6}{'at most':>9}{'errors':>8}  findings")
    with chromium() as browser:
        for path in options.pages:
            for viewport, size in VIEWPORTS.items():
                for scheme in ("light", "dark"):
                    width, errors, found = _checked(browser, path, viewport, scheme, rules, options.output)
                    faults += width > size[0] or errors > 0 or any(found[impact] for impact in SERIOUS)
                    words = ", ".join(f"{count} {impact}" for impact, count in found.items()) or "none"
                    shown = words if rules else "not looked for"
                    print(f"{path.name:28}{viewport + ', ' + scheme:18}{width:6}{size[0]:9}{errors:8}  {shown}")
    sys.exit(1 if faults else 0)


def _checked(browser, path, viewport, scheme, rules, folder):
    """Width of the page [px], number of errors, and findings by impact."""
    width, height = VIEWPORTS[viewport]
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    errors = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(path.resolve().as_uri())
    page.wait_for_timeout(SETTLED_MS)
    widest = page.evaluate("document.documentElement.scrollWidth")
    if folder is not None:
        page.screenshot(path=folder / f"{path.stem}-{viewport}-{scheme}.png", full_page=True)
        if (viewport, scheme) == ("desktop", "light"):
            page.pdf(path=folder / f"{path.stem}.pdf", format="A4")
    found = Counter()
    if rules:
        page.evaluate(rules)
        for violation in page.evaluate("axe.run()")["violations"]:
            found[violation["impact"]] += len(violation["nodes"])
    page.close()
    return widest, len(errors), found


if __name__ == "__main__":
    main()
