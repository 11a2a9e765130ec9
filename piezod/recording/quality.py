"""What is noteworthy about a recording, one line each, as one would warn a colleague who is about to use it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from piezod.recording.stretches import Stretch, gaps, typical_run

if TYPE_CHECKING:
    from piezod.recording.recording import Recording

COMMANDS = ("voltage", "reference")
"""Channels of these quantities are commands: they stand still and reach their limits on purpose."""

UNUSUAL = 10
"""A run of identical readings is noteworthy when it is so many times longer than the channel's typical one."""


def describe(recording: Recording) -> list[str]:
    """One line for each thing noteworthy: irregular time, gaps, missing samples, frozen and clipped readings."""
    lines = _time(recording)
    for name in recording.channels:
        lines += _missing(recording, name)
        if not name.startswith(COMMANDS) and recording.time_s.size:
            lines += _stuck(recording, name)
    return lines


def _time(recording: Recording) -> list[str]:
    time_s = recording.time_s
    if time_s.size < 3:
        return [f"time_s: has {time_s.size} samples"]
    lines = []
    if not recording.uniform:
        periods = np.diff(time_s)
        extent = f"periods of {periods.min():.6g} to {periods.max():.6g} s, median {recording.dt_s:.6g} s"
        lines.append(f"time_s: irregular, {extent}")
    pauses = gaps(time_s)
    if pauses:
        places = ", ".join(f"{time_s[k]:.6g} to {time_s[m]:.6g} s" for k, m in pauses[:5])
        more = f" and {len(pauses) - 5} more" if len(pauses) > 5 else ""
        lines.append(f"time_s: {_count(len(pauses), 'gap')} longer than 5 periods, {places}{more}")
    return lines


def _missing(recording: Recording, name: str) -> list[str]:
    mask = recording.missing(name)
    if not mask.any():
        return []
    first_s = recording.time_s[int(np.argmax(mask))]
    share = f"{100 * mask.mean():.3g} %"
    return [f"{name}: {_count(int(mask.sum()), 'sample')} missing ({share}), the first at {first_s:.6g} s"]


def _stuck(recording: Recording, name: str) -> list[str]:
    values = recording.channel(name)
    unusual = UNUSUAL * typical_run(values)
    lines = []
    clipped = recording.clipped(name, at_least=int(max(5, unusual)))
    highest = np.nanmax(values) if clipped else np.nan
    for what, at_top in (("largest", True), ("smallest", False)):
        stretches = [s for s in clipped if (values[s[0]] == highest) == at_top]
        if stretches:
            value = f"{values[stretches[0][0]]:.6g}"
            lines.append(f"{name}: clipped at its {what} value {value}, {_places(recording, stretches)}")
    frozen = [s for s in recording.frozen(name, longer_than=int(max(20, unusual))) if s not in clipped]
    if frozen:
        lines.append(f"{name}: stands still while others move, {_places(recording, frozen)}")
    return lines


def _places(recording: Recording, stretches: list[Stretch]) -> str:
    start, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    longest = f"{recording.time_s[start]:.6g} to {recording.time_s[stop - 1]:.6g} s"
    return f"in {_count(len(stretches), 'stretch')}, the longest of {stop - start} samples from {longest}"


def _count(number: int, noun: str) -> str:
    plural = "es" if noun.endswith("ch") else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"
