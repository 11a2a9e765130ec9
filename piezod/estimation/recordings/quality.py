"""Warnings about a recording: irregular time, gaps, missing samples, frozen and clipped readings, one line each."""

import numpy as np

from piezod.estimation.recordings.stuck import StuckStretches
from piezod.recording.recording import Recording
from piezod.recording.stretches import Stretch, extreme_periods, gaps

MOST_PLACES = 5  # gaps that a line lists


def describe_timing(recording: Recording) -> list[str]:
    """Lines about unequal sample periods and gaps in time, for a recording of at least two samples."""
    time_s = recording.time_s
    lines = []
    if not recording.uniform:
        shortest_s, longest_s = extreme_periods(time_s)
        extent = f"periods of {shortest_s:.6g} to {longest_s:.6g} s, median {recording.dt_s:.6g} s"
        lines.append(f"time_s: irregular, {extent}")
    pauses = gaps(time_s)
    if pauses:
        places = ", ".join(f"{time_s[k]:.6g} to {time_s[m]:.6g} s" for k, m in pauses[:MOST_PLACES])
        more = f" and {len(pauses) - MOST_PLACES} more" if len(pauses) > MOST_PLACES else ""
        lines.append(f"time_s: {_count(len(pauses), 'gap')} longer than 5 periods, {places}{more}")
    return lines


def describe_missing(recording: Recording, name: str) -> list[str]:
    """Line about the missing samples of a channel: number, share, time of the first; no line for a complete channel.

    Raises
    ------
    RecordingError
        The recording has no channel of this name.
    """
    mask = recording.missing(name)
    if not mask.any():
        return []
    first_s = recording.time_s[int(np.argmax(mask))]
    share = f"{100 * mask.mean():.3g} %"
    return [f"{name}: {_count(int(mask.sum()), 'sample')} missing ({share}), the first at {first_s:.6g} s"]


def describe_stuck(recording: Recording, name: str, stuck: StuckStretches) -> list[str]:
    """Lines about the frozen and clipped samples of a channel, as `find_stuck` found them."""
    values = recording.channel(name)
    lines = [
        f"{name}: clipped at its {extreme} value {values[stretches[0][0]]:.6g}, {_places(recording, stretches)}"
        for extreme, stretches in (("largest", stuck.at_largest), ("smallest", stuck.at_smallest))
        if stretches
    ]
    frozen = [f"{name}: constant while its drive moves, {_places(recording, stuck.frozen)}"] if stuck.frozen else []
    return lines + frozen


def _places(recording: Recording, stretches: list[Stretch]) -> str:
    start, stop = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    longest = f"{recording.time_s[start]:.6g} to {recording.time_s[stop - 1]:.6g} s"
    return f"in {_count(len(stretches), 'stretch')}, the longest of {stop - start} samples from {longest}"


def _count(number: int, noun: str) -> str:
    plural = "es" if noun.endswith("ch") else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"
