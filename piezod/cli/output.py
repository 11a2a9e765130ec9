"""Output of a command: result and next step, as text or JSON; colour of warnings on a terminal.

A pipe or a file gets plain text, as with NO_COLOR (https://no-color.org).
"""

import json
import os
import re
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from piezod.report.next_step import NextStep

RED, ORANGE, GREEN, PLAIN = "\x1b[1;31m", "\x1b[33m", "\x1b[32m", "\x1b[0m"
FEW_MISSED_PERCENT = 0.01  # share of missed ticks that a machine may have: `piezod latency` calls such a rate held
_WORDS = {
    RED: re.compile(r"\b(?:FAULT|DRIFTED|STALE|RAILED|DEGRADED|FAIL|FAILED|NOT PASSED)\b"),
    ORANGE: re.compile(r"\b(?:WARN|HOLD|RAMP_DOWN)\b"),
    GREEN: re.compile(r"\b(?:RUNNING|OK|passed)\b"),
}
_MISSED = re.compile(r"\d+ \(([\d.e+-]+) %\) missed")


def print_result(content: Mapping[str, Any], text: str, step: "NextStep", *, as_json: bool) -> None:
    """Print a result with its next step.

    Parameters
    ----------
    content
        Result for JSON, which gets the key `next_step`.
    text
        Result for a person.
    """
    if as_json:
        print(json.dumps({**content, "next_step": step.as_dict()}, indent=2))
    else:
        print(text)
        print_next(step)


def print_next(step: "NextStep") -> None:
    """Print the next step, after an empty line."""
    print(f"\n{step.text()}")


def coloured(text: str) -> str:
    """Text of a status or of checks, with its warnings in colour on a terminal that the user permits to colour."""
    if not sys.stdout.isatty() or "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb":
        return text
    for colour, words in _WORDS.items():
        text = words.sub(rf"{colour}\g<0>{PLAIN}", text)
    return _MISSED.sub(_missed, text)


def _missed(match: "re.Match[str]") -> str:
    return f"{ORANGE if float(match[1]) <= FEW_MISSED_PERCENT else RED}{match[0]}{PLAIN}"
