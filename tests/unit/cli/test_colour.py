"""Warnings have a colour on a terminal only."""

import sys

import pytest

from piezod.cli.output import GREEN, ORANGE, PLAIN, RED, coloured


@pytest.fixture
def terminal(monkeypatch):
    """A terminal whose user permits colour."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")


@pytest.mark.parametrize(
    ("text", "colour", "word"),
    [
        ("press: RUNNING, armed", GREEN, "RUNNING"),
        ("model: DRIFTED; 0.5 N rms", RED, "DRIFTED"),
        ("press: STALE, the values are 3.0 s old", RED, "STALE"),
        ("100000 ticks at 5 Hz, 3 (0.003 %) missed, 0 failed", ORANGE, "3 (0.003 %) missed"),
        ("100 ticks at 5 Hz, 3 (2.9 %) missed, 0 failed", RED, "3 (2.9 %) missed"),
    ],
)
def test_a_warning_has_its_colour(text, colour, word, terminal):
    assert coloured(text) == text.replace(word, f"{colour}{word}{PLAIN}")


def test_a_text_without_warnings_stays_as_it_is(terminal):
    text = "100 ticks at 5 Hz, 0 missed, 0 failed exchanges; up 3 s"
    assert coloured(text) == text


def test_a_pipe_gets_plain_text(capsys):
    assert coloured("press: FAULT") == "press: FAULT"
