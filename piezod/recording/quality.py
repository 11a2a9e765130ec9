"""What is noteworthy about a recording, one line each, as one would warn a colleague who is about to use it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from piezod.recording.stretches import Stretch, extreme_periods, gaps

if TYPE_CHECKING:
    from collections.abc import Iterator

    from piezod.recording.recording import Recording
    from piezod.recording.stuck import Stuck

COMMANDS = ("voltage", "reference")
"""Channels of these quantities are commands: they stand still and reach their limits on purpose, and drive the rest."""


def describe(recording: Recording) -> list[str]:
    """One line for each thing noteworthy: irregular time, gaps, missing samples, frozen and clipped readings."""
    lines = irregular(recording) if recording.time_s.size > 2 else [f"time_s: has {recording.time_s.size} samples"]
    drives = [name for name in recording.channels if name.startswith(COMMANDS)]
    for name in recording.channels:
        lines += missing(recording, name)
        others = [other for other in recording.channels if other != name]
        for drive in () if name in drives else (drives or others)[:1]:
            lines += standing(recording, name, recording.stuck(name, drive))
    return lines


def irregular(recording: Recording) -> list[str]:
    """How far periods differ from each other, and where time pauses; of at least two samples."""
    time_s = recording.time_s
    lines = []
    if not recording.uniform:
        shortest_s, longest_s = extreme_periods(time_s)
        extent = f"periods of {shortest_s:.6g} to {longest_s:.6g} s, median {recording.dt_s:.6g} s"
        lines.append(f"time_s: irregular, {extent}")
    pauses = gaps(time_s)
    if pauses:
        places = ", ".join(f"{time_s[k]:.6g} to {time_s[m]:.6g} s" for k, m in pauses[:5])
        more = f" and {len(pauses) - 5} more" if len(pauses) > 5 else ""
        lines.append(f"time_s: {_count(len(pauses), 'gap')} longer than 5 periods, {places}{more}")
    return lines


def missing(recording: Recording, name: str) -> list[str]:
    """How many samples of a channel are not there, and where the first is."""
    mask = recording.missing(name)
    if not mask.any():
        return []
    first_s = recording.time_s[int(np.argmax(mask))]
    share = f"{100 * mask.mean():.3g} %"
    return [f"{name}: {_count(int(mask.sum()), 'sample')} missing ({share}), the first at {first_s:.6g} s"]


def standing(recording: Recording, name: str, found: Stuck) -> list[str]:
    """Where a reading is frozen or cut off."""
    return list(_standing(recording, name, found))


def _standing(recording: Recording, name: str, found: Stuck) -> Iterator[str]:
    values = recording.channel(name)
    for what, stretches in (("largest", found.at_largest), ("smallest", found.at_smallest)):
        if stretches:
            value = f"{values[stretches[0][0]]:.6g}"
            yield f"{name}: clipped at its {what} value {value}, {_places(recording, stretches)}"
    if found.frozen:
        yield f"{name}: stands still while its drive moves, {_places(recording, found.frozen)}"


def _places(recording: Recording, stretches: list[Stretch]) -> str:
    start, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    longest = f"{recording.time_s[start]:.6g} to {recording.time_s[stop - 1]:.6g} s"
    return f"in {_count(len(stretches), 'stretch')}, the longest of {stop - start} samples from {longest}"


def _count(number: int, noun: str) -> str:
    plural = "es" if noun.endswith("ch") else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"
