"""Warnings have a colour on a terminal only."""

import pytest

from piezod.cli.colour import GREEN, ORANGE, PLAIN, RED, coloured, print_coloured


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
def test_a_warning_has_its_colour(text, colour, word):
    assert coloured(text) == text.replace(word, f"{colour}{word}{PLAIN}")


def test_a_text_without_warnings_stays_as_it_is():
    text = "100 ticks at 5 Hz, 0 missed, 0 failed exchanges; up 3 s"
    assert coloured(text) == text


def test_a_pipe_gets_plain_text(capsys):
    print_coloured("press: FAULT")
    assert capsys.readouterr().out == "press: FAULT\n"
