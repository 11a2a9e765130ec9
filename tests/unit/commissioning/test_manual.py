"""The manual of `piezod docs`: its topics, its links, and what a screen without a browser gets."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from piezod.commissioning import manual
from piezod.commissioning.manual import Topic, has_display, open_in_browser, topics, write_manual
from piezod.errors import ConfigurationError

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("manual")
    write_manual(folder)
    return {page.stem: page.read_text(encoding="utf-8") for page in folder.iterdir()}


def test_every_readme_but_those_of_the_tests_is_a_topic():
    rooms = (ROOT / room for room in ("config", "systemd", "piezod", "firmware_sim"))
    readmes = {ROOT / "README.md", *(path for room in rooms for path in room.rglob("README.md"))}
    assert {topic.file for topic in topics().values() if topic.file.name == "README.md"} == readmes


def test_every_page_of_a_device_is_a_topic():
    assert {path.stem for path in (ROOT / "config").glob("*.md")} - {"README"} <= topics().keys()


def test_every_link_between_pages_leads_to_a_heading(pages):
    links = [
        (name, *link.groups())
        for name, page in pages.items()
        for link in re.finditer(r'href=["\'](\w+)\.html#?([^"\']*)["\']', page)
    ]
    assert len(links) > 100
    for name, target, heading in links:
        assert target in pages, (name, target)
        assert not heading or f'id="{heading}"' in pages[target], (name, target, heading)


def test_a_link_to_a_file_that_is_not_installed_becomes_text(monkeypatch, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n\nBefore [the *study*](../tests/README.md) and [site](https://example.org).\n")
    monkeypatch.setattr(manual, "topics", lambda: {"page": Topic("page", "config/page.md", "Page")})
    monkeypatch.setattr(manual, "shipped_path", lambda name: tmp_path / Path(name).name if "page" in name else Path())
    write_manual(tmp_path / "out")
    text = (tmp_path / "out" / "page.html").read_text(encoding="utf-8")
    assert 'Before the <em>study</em> and <a href="https://example.org">site</a>.' in text


def test_a_page_loads_nothing_from_elsewhere(pages):
    assert "[Picture: Live page of a running bench" in pages["overview"]
    assert [name for name, page in pages.items() if re.search(r"<img|<script|<link|src=|@import", page)] == []


def test_text_of_an_example_is_escaped(pages):
    assert "<pre># Bench file" in pages["bench"]
    assert "->" not in pages["bench"].partition("<pre>")[2]


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"DISPLAY": "", "WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_a_display_is_named_by_the_environment_on_linux(platform, variables, expected, monkeypatch):
    monkeypatch.setattr(sys, "platform", platform)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert has_display() is expected


def test_a_browser_opens_the_page_of_the_topic_from_the_cache(monkeypatch, tmp_path):
    opened = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address))
    assert open_in_browser(topics()["api"])
    assert opened[0].startswith(f"file://{tmp_path}/piezod/manual-")
    assert '<h1 id="python">' in Path(opened[0].removeprefix("file://")).read_text(encoding="utf-8")


def test_a_cache_that_cannot_be_written_is_refused(monkeypatch, tmp_path):
    (tmp_path / "piezod").write_text("a file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(ConfigurationError, match="cannot be written"):
        open_in_browser(topics()["api"])


def test_output_that_is_no_terminal_is_the_file_as_it_is():
    command = [sys.executable, "-m", "piezod", "docs", "systemd"]
    done = subprocess.run(command, env=os.environ | {"DISPLAY": ":0"}, capture_output=True, text=True, check=True)
    assert done.stdout == (ROOT / "systemd" / "README.md").read_text(encoding="utf-8")
