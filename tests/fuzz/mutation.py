"""Random changes to valid inputs from a seeded generator: changed bytes, and YAML lines with odd values."""

import re
from pathlib import Path
from random import Random

MOST_CHANGES = 4
LARGEST = 2**16
"""Largest size of an input [byte]."""

NUMBERS = (0, 1, 2, 3, 127, 128, 255, 256, *(2**k + d for k in (15, 16, 31, 32, 63) for d in (-1, 0)), 2**64 - 1)
"""Critical values of lengths, counts and positions."""

ODD_VALUES = (
    *(Path(__file__).parent / "odd_values.txt").read_text(encoding="utf-8").splitlines(),
    "1" * 5000,
    "[" * 200,
)
"""Wrong values that a user or an attacker may write."""

_LINE = re.compile(rb"^(\s*(?:- )?)([A-Za-z_]\w*)(:)(.*)$")


def mutate(random: Random, data: bytes, seeds: list[bytes]) -> bytes:
    """Change some bytes."""
    changed = bytearray(data)
    for _ in range(random.randint(1, MOST_CHANGES)):
        random.choice(_CHANGES)(random, changed, seeds)
    return bytes(changed[:LARGEST])


def mutate_yaml(random: Random, data: bytes, seeds: list[bytes]) -> bytes:
    """Change some lines, or some bytes."""
    if random.random() < 0.25:
        return mutate(random, data, seeds)
    lines = data.split(b"\n")
    for _ in range(random.randint(1, MOST_CHANGES)):
        random.choice(_LINE_CHANGES)(random, lines)
    return b"\n".join(lines)[:LARGEST]


def _flip(random: Random, data: bytearray, _: list[bytes]) -> None:
    if data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _set(random: Random, data: bytearray, _: list[bytes]) -> None:
    if data:
        data[random.randrange(len(data))] = random.choice((0, 1, 9, 10, 32, 44, 127, 128, 255, random.randrange(256)))


def _number(random: Random, data: bytearray, _: list[bytes]) -> None:
    size = random.choice((2, 4, 8))
    if len(data) >= size:
        at = random.randrange(len(data) - size + 1)
        order = random.choice(("little", "big"))
        data[at : at + size] = (random.choice(NUMBERS) % (1 << 8 * size)).to_bytes(size, order)


def _near(random: Random, data: bytearray, _: list[bytes]) -> None:
    """A number of the line, changed slightly."""
    size = random.choice((1, 2, 4, 8))
    if len(data) >= size:
        at = random.randrange(len(data) - size + 1)
        order = random.choice(("little", "big"))
        value = int.from_bytes(data[at : at + size], order) + random.choice((-8, -2, -1, 1, 2, 8))
        data[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, order)


def _cut(random: Random, data: bytearray, _: list[bytes]) -> None:
    first, last = _span(random, data)
    del data[first:last]


def _end(random: Random, data: bytearray, _: list[bytes]) -> None:
    del data[random.randint(0, len(data)) :]


def _again(random: Random, data: bytearray, _: list[bytes]) -> None:
    first, last = _span(random, data)
    at = random.randint(0, len(data))
    data[at:at] = data[first:last]


def _insert(random: Random, data: bytearray, _: list[bytes]) -> None:
    at = random.randint(0, len(data))
    data[at:at] = random.randbytes(random.choice((1, 2, 4, 16)))


def _graft(random: Random, data: bytearray, seeds: list[bytes]) -> None:
    other = random.choice(seeds)
    first, last = _span(random, other)
    at = random.randint(0, len(data))
    data[at : at + random.choice((0, last - first))] = other[first:last]


def _span(random: Random, data: bytes | bytearray) -> tuple[int, int]:
    """Start and end of a random range of bytes, mostly short."""
    first = random.randint(0, len(data))
    return first, min(len(data), first + int(2 ** random.uniform(0, 10)))


_CHANGES = (_flip, _set, _number, _number, _near, _cut, _end, _again, _insert, _graft)


def _odd_value(random: Random, lines: list[bytes]) -> None:
    at = random.randrange(len(lines))
    if found := _LINE.match(lines[at]):
        lines[at] = found[1] + found[2] + b": " + random.choice(ODD_VALUES).encode()


def _other_number(random: Random, lines: list[bytes]) -> None:
    at = random.randrange(len(lines))
    factor = random.choice((0, -1, 1e-9, 0.1, 2, 10, 1e6, 1e300))
    lines[at] = re.sub(rb"(?<=: )-?\d+(\.\d*)?$", lambda number: f"{factor * float(number[0])!r}".encode(), lines[at])


def _other_key(random: Random, lines: list[bytes]) -> None:
    at, other = random.randrange(len(lines)), _LINE.match(random.choice(lines))
    if (found := _LINE.match(lines[at])) and other:
        lines[at] = (
            found[1] + random.choice((other[2], found[2] + b"x", b"~", b"? a", b"<<", b"!!merge <<")) + b":" + found[4]
        )


def _drop_line(random: Random, lines: list[bytes]) -> None:
    if len(lines) > 1:
        del lines[random.randrange(len(lines))]


def _repeat_line(random: Random, lines: list[bytes]) -> None:
    lines.insert(random.randint(0, len(lines)), random.choice(lines))


def _indent(random: Random, lines: list[bytes]) -> None:
    at = random.randrange(len(lines))
    lines[at] = random.choice((b"  " + lines[at], lines[at].lstrip(), b"- " + lines[at], b"\t" + lines[at]))


_LINE_CHANGES = (
    _odd_value,
    _odd_value,
    _odd_value,
    _other_number,
    _other_number,
    _other_key,
    _drop_line,
    _repeat_line,
    _indent,
)
