"""The frame that every page shares: self-contained, works offline, prints to A4."""

import html
import os
from pathlib import Path

from bokeh.embed import file_html
from bokeh.models import LayoutDOM
from bokeh.resources import INLINE
from jinja2 import Template

from piezod.errors import ConfigurationError

# Okabe and Ito's palette (2008) stays apart for colour-blind eyes.
BLUE, ORANGE, GREEN, GREY, RED = "#0072B2", "#E69F00", "#009E73", "#999999", "#D55E00"

_TEMPLATE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title | e }}</title>
{{ bokeh_css | safe }}
{{ bokeh_js | safe }}
<style>
body { font-family: system-ui, sans-serif; margin: 0 auto; max-width: 1200px; padding: 1rem; color: #222; }
@page { size: A4; margin: 12mm; }
</style>
</head>
<body>
{{ plot_div | safe }}
{{ plot_script | safe }}
</body>
</html>
""")

STYLE = """<style>
h1 { font-size: 1.5rem; margin: 0.3rem 0; } h2 { font-size: 1.15rem; margin: 1rem 0 0; }
.verdict { font-size: 1.1rem; }
table { border-collapse: collapse; } th, td { padding: 0.25rem 0.8rem; border-bottom: 1px solid #ddd; text-align:
right; } th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left; }
</style>"""


def table_html(header: list[str], rows: list[list[str]]) -> str:
    """A table, every cell escaped."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"{STYLE}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def write_page(path: Path, title: str, layout: LayoutDOM) -> None:
    """Write one self-contained page, whole or not at all.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    write_text(path, file_html(layout, INLINE, title, template=_TEMPLATE))


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all; its folder is made.

    Raises
    ------
    ConfigurationError
        It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error
