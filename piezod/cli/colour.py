"""Colour of warnings on a terminal. A pipe or a file gets plain text, as with NO_COLOR (https://no-color.org)."""

import os
import re
import sys

RED, ORANGE, GREEN, PLAIN = "\x1b[1;31m", "\x1b[33m", "\x1b[32m", "\x1b[0m"
FEW_MISSED_PERCENT = 0.01  # share of missed ticks that a machine may have: `piezod latency` calls such a rate held
_WORDS = {
    RED: re.compile(r"\b(?:FAULT|DRIFTED|STALE|RAILED|DEGRADED|FAIL|FAILED|NOT PASSED)\b"),
    ORANGE: re.compile(r"\b(?:WARN|HOLD|RAMP_DOWN)\b"),
    GREEN: re.compile(r"\b(?:RUNNING|OK|passed)\b"),
}
_MISSED = re.compile(r"\d+ \(([\d.e+-]+) %\) missed")


def wants_colour() -> bool:
    """Whether the output is a terminal, and the user does not refuse colour."""
    return sys.stdout.isatty() and "NO_COLOR" not in os.environ and os.environ.get("TERM") != "dumb"


def coloured(text: str) -> str:
    """Text with its warnings in colour.

    Parameters
    ----------
    text
        Plain text of a status or of checks.
    """
    for colour, words in _WORDS.items():
        text = words.sub(rf"{colour}\g<0>{PLAIN}", text)
    return _MISSED.sub(_missed, text)


def _missed(match: "re.Match[str]") -> str:
    return f"{ORANGE if float(match[1]) <= FEW_MISSED_PERCENT else RED}{match[0]}{PLAIN}"


def print_coloured(text: str) -> None:
    """Print a text, with colour on a terminal."""
    print(coloured(text) if wants_colour() else text)
