"""Counts of the values of a live reference: how many were accepted, and how many were refused for which reason."""

from collections.abc import Sequence
from enum import IntEnum


class ValueResult(IntEnum):
    """Result of the check of one value; its number is its place in the counters of the ring log."""

    ACCEPTED = 0
    MALFORMED = 1
    """Of another size, or not finite."""
    OUT_OF_RANGE = 2
    """Beyond the range of the reference."""
    OUT_OF_ORDER = 3
    """Not newer than the value before: an old or repeated number or session."""
    JUMPED = 4
    """The number rises faster than a sender can count."""
    UNAUTHENTICATED = 5
    """Without a valid tag of the shared key."""
    MISTIMED = 6
    """The time of the sender differs too much from the time of this machine."""


def new_counts() -> "memoryview[int]":
    """Counts of all results, 0."""
    return memoryview(bytearray(8 * len(ValueResult))).cast("Q")


def counts_dict(counters: Sequence[int]) -> dict[str, int]:
    """Counts by name, in lower case; 0 for a counter that is missing.

    Parameters
    ----------
    counters
        Counters of the ring log.
    """
    return {result.name.lower(): counters[result] if result < len(counters) else 0 for result in ValueResult}
