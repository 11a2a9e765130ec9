"""What is fuzzed: a parser, valid inputs to begin with, and how an input is judged."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from piezod.errors import PiezodError
from tests.fuzz.mutation import mutate

LONGEST_MESSAGE = 1000

Check = Callable[[bytes], None]
Mutate = Callable[[Random, bytes, list[bytes]], bytes]


@dataclass(frozen=True)
class Target:
    """One parser.

    Parameters
    ----------
    name
        Of the parser, for the table and for `--reproduce`.
    group
        What is counted on the command line: frames, configurations, models, recordings or messages.
    seeds
        Makes the valid inputs.
    check
        Makes what is called with each input: it raises PiezodError when the parser refuses, and anything else when a
        promise is broken.
    mutate
        Changes an input.
    """

    name: str
    group: str
    seeds: Callable[[], list[bytes]]
    check: Callable[[], Check]
    mutate: Mutate = mutate


def judge(check: Check, data: bytes) -> str:
    """Try one input; empty when all is well, else what is wrong, the last line in short."""
    try:
        check(data)
    except PiezodError as error:
        return complaint(error)
    except Exception as error:  # noqa: BLE001  # whatever a parser lets out is what is looked for
        return f"{traceback.format_exc(limit=-6).strip()}\n{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return ""


def complaint(error: PiezodError) -> str:
    """Say what is wrong with a refusal; empty when it is one printable line, and not for want of memory."""
    text = str(error)
    if not text or not text.isprintable():
        return f"{type(error).__name__} is not one printable line: {text[:200]!r}"
    if len(text) > LONGEST_MESSAGE:
        return f"{type(error).__name__} has {len(text)} characters: {text[:100]!r}"
    if isinstance(error.__cause__, MemoryError):
        return f"memory ran out before the input was refused: {text[:200]!r}"
    return ""


def peak_resident_KiB() -> int:  # a unit
    """Of this program alone: `ru_maxrss` begins with what the process had in it that started it."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    return int(fields["VmHWM"].split()[0])
