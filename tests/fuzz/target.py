"""A fuzzing target: a parser, its valid inputs, and the check of an input."""

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
        Name of the parser in the table and for `--reproduce`.
    group
        Option of the command line that counts it: frames, configurations, models, recordings or messages.
    seeds
        Function that makes the valid inputs.
    check
        Function that makes the check. The check takes an input, raises PiezodError when the parser refuses it, and any
        other exception for a violation.
    mutate
        Function that changes an input.
    """

    name: str
    group: str
    seeds: Callable[[], list[bytes]]
    check: Callable[[], Check]
    mutate: Mutate = mutate


def find_violation(check: Check, data: bytes) -> str:
    """Try one input; returns the violation, with a short last line, or an empty text."""
    try:
        check(data)
    except PiezodError as error:
        return complaint(error)
    except Exception as error:  # noqa: BLE001  # any other exception is a violation
        return f"{traceback.format_exc(limit=-6).strip()}\n{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return ""


def complaint(error: PiezodError) -> str:
    """The violation of a refusal: not one printable line, too long, or caused by lack of memory; else empty."""
    text = str(error)
    if not text or not text.isprintable():
        return f"{type(error).__name__} is not one printable line: {text[:200]!r}"
    if len(text) > LONGEST_MESSAGE:
        return f"{type(error).__name__} has {len(text)} characters: {text[:100]!r}"
    if isinstance(error.__cause__, MemoryError):
        return f"memory ran out before the input was refused: {text[:200]!r}"
    return ""


def peak_resident_KiB() -> int:  # a unit
    """Peak resident memory of this program; `ru_maxrss` would include that of the parent before exec."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    return int(fields["VmHWM"].split()[0])
