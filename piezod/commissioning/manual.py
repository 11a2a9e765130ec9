"""The manual: pages that are installed with the program, as text and as HTML for a browser.

The pages are the READMEs of the repository, the pages of the devices, and two commented example files. An installed
wheel holds copies. HTML pages link to each other; a link to a file that is not installed becomes plain text.
"""

import difflib
import html
import os
import posixpath
import re
import sys
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token

from piezod import __version__
from piezod.commissioning.shipped_files import shipped, shipped_path
from piezod.errors import UsageError
from piezod.report.style import PAGE_CSS
from piezod.report.text_table import text_table
from piezod.runtime.files import written

FIRST = "overview"  # topic that is shown if none is named
_READMES = {
    FIRST: "README.md",
    "config": "config/README.md",
    "systemd": "systemd/README.md",
    "piezod": "piezod/README.md",
    "api": "piezod/api/README.md",
    "diagnose": "piezod/diagnose/README.md",
    "effects": "piezod/effects/README.md",
    "operators": "piezod/operators/README.md",
    "blind": "piezod/blind/README.md",
    "firmware_sim": "firmware_sim/README.md",
}
_EXAMPLES = {
    "bench": ("config/bench.yaml", "A bench file, with a comment on every key"),
    "emulator": ("config/emulator.yaml", "A configuration of the emulated bench"),
}
_CSS = f"""{PAGE_CSS}
pre {{ background: var(--soft); padding: 8px 12px; overflow-x: auto; }}
main {{ max-width: 900px; }} nav {{ margin-bottom: 14px; }}
"""
_TEMPLATE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<nav>{topics}</nav>
<main>
{body}
</main>
</body>
</html>
"""


@dataclass(frozen=True)
class Topic:
    """One page of the manual; `path` is its path in the repository."""

    name: str
    path: str
    title: str

    @property
    def file(self) -> Path:
        """The installed file, or the file of the checkout."""
        return shipped_path(self.path)

    @property
    def text(self) -> str:
        """Content of the file."""
        return self.file.read_text(encoding="utf-8")

    @property
    def is_markdown(self) -> bool:
        """Whether the file is Markdown; the others are YAML."""
        return self.path.endswith(".md")


def topics() -> dict[str, Topic]:
    """All pages by name: the READMEs, the devices, the examples."""
    devices = sorted(path.stem for path in shipped("bench.yaml").parent.glob("*.md") if path.stem != "README")
    pages = _READMES | {device: f"config/{device}.md" for device in devices}
    found = {name: Topic(name, path, _heading(shipped_path(path))) for name, path in pages.items()}
    return found | {name: Topic(name, path, title) for name, (path, title) in _EXAMPLES.items()}


def topic_named(name: str) -> Topic:
    """Return a page of the manual.

    Raises
    ------
    UsageError
        The manual has no page of that name. The message gives the most similar name.
    """
    known = topics()
    if name in known:
        return known[name]
    nearest = max(known, key=lambda topic: difflib.SequenceMatcher(None, name.lower(), topic).ratio())
    raise UsageError(f"no topic is named '{name}', the nearest is '{nearest}'; 'piezod docs --list' lists all")


def topics_table() -> str:
    """Format one line for each topic: name and title."""
    rows = [("topic", "title"), *((topic.name, topic.title) for topic in topics().values())]
    return "\n".join(text_table(rows, left_aligned=2))


def topic_as_dict(topic: Topic) -> dict[str, Any]:
    """Return a topic for JSON."""
    return {"name": topic.name, "title": topic.title, "file": str(topic.file)}


def has_display() -> bool:
    """Whether a browser can open a window; on Linux a variable of the environment names the display."""
    return not sys.platform.startswith("linux") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


def open_in_browser(topic: Topic) -> bool:
    """Write the pages into the user's cache folder and open one; return whether a browser was found.

    Raises
    ------
    ConfigurationError
        A page cannot be written.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "piezod" / f"manual-{__version__}"
    write_manual(folder)
    return webbrowser.open((folder / f"{topic.name}.html").absolute().as_uri())


def write_manual(folder: Path) -> None:
    """Write every topic as `NAME.html`.

    Raises
    ------
    ConfigurationError
        A page cannot be written.
    """
    known = topics()
    names = {topic.path: topic.name for topic in known.values()}
    links = " | ".join(f"<a href='{name}.html'>{name}</a>" for name in known)
    for topic in known.values():
        if topic.is_markdown:
            body = _html_of(topic, names)
        else:
            body = f"<h1>{html.escape(topic.title)}</h1><pre>{html.escape(topic.text)}</pre>"
        page = _TEMPLATE.format(title=html.escape(topic.title), style=_CSS, topics=links, body=body)
        written(folder / f"{topic.name}.html", page, parents=True)


def _heading(file: Path) -> str:
    """First heading of a page, without its signs."""
    with file.open(encoding="utf-8") as lines:
        return next(lines).lstrip("# ").rstrip().replace("`", "")


def _html_of(topic: Topic, names: dict[str, str]) -> str:
    """HTML of a Markdown page; `names` holds the name of each topic by its path."""
    reader = MarkdownIt("commonmark").enable("table")
    tokens = reader.parse(topic.text)
    for token, following in zip(tokens, [*tokens[1:], None], strict=True):
        if token.type == "heading_open" and following is not None:
            title = re.sub(r"[^\w\- ]", "", following.content.lower())
            token.attrSet("id", title.replace(" ", "-"))  # the name by which links refer to a heading
        is_dead = False
        for child in token.children or ():
            if child.type == "image":
                _make_text(child, f"[Picture: {child.content}]")  # the wheel holds no pictures
            elif child.type == "link_open":
                target = _target(str(child.attrGet("href")), topic.path, names)
                is_dead = target is None
                child.attrSet("href", target or "")
            if is_dead and child.type in ("link_open", "link_close"):
                is_dead = child.type != "link_close"
                _make_text(child, "")
    return str(reader.renderer.render(tokens, reader.options, {}))


def _make_text(token: Token, content: str) -> None:
    """Replace a picture, or an end of a link, by text."""
    token.type, token.content, token.tag = "text", content, ""


def _target(link: str, page: str, names: dict[str, str]) -> str | None:
    """Target of a link between the HTML pages; None where the file is not installed."""
    path, _, heading = link.partition("#")
    if "://" in link or not path:
        return link
    wanted = posixpath.normpath(posixpath.join(posixpath.dirname(page), path))
    if wanted in names:
        return f"{names[wanted]}.html" + (f"#{heading}" if heading else "")
    return shipped_path(wanted).as_uri() if shipped_path(wanted).is_file() else None
