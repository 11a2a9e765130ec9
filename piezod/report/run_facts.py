"""Facts of a run beside its figures: bench, model, date, limits, drift, missed ticks, reason of the largest error."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.control import State
from piezod.errors import RecordingError
from piezod.recording import Recording, read_recording
from piezod.transport.link import ExchangeResult

OUTLIER = 5.0
"""Multiple of the rms error above which the largest error is an outlier: of 1e6 normal values one is larger."""
SPIKE = 3.0  # multiple of the rms error below which both neighbours of an outlier make it a single sample
NEAR_S = 0.1  # time before an error in which a gap or a limit counts as its reason [s]: the loop has settled after it
FIRST_S = 1.0  # time after the begin of RUNNING in which an error belongs to the approach [s]
HELD_BACK = 1e-3
"""Difference of planned and written voltage that counts as held back by a limit, as share of the voltage's range."""


def held_back(recording: Recording) -> NDArray[np.bool_]:
    """Mask of the samples whose voltage a limit held back, shape (N,); all False without `planned_V`."""
    planned, written = recording.channels.get("planned_V"), recording.channels.get("voltage_V")
    if planned is None or written is None:
        return np.zeros(recording.time_s.size, dtype=np.bool_)
    difference = np.abs(planned - written)
    span = float(np.nanmax(written) - np.nanmin(written)) if np.isfinite(written).any() else 0.0
    state = recording.channels.get("state")
    running = np.ones(difference.size, dtype=np.bool_) if state is None else state == State.RUNNING
    result: NDArray[np.bool_] = running & (np.nan_to_num(difference) > max(HELD_BACK * span, 1e-9))
    return result


def outlier_reason(recording: Recording, error: Array) -> str | None:
    """Why the largest error of a run is far above its rms; None: it is not.

    Parameters
    ----------
    error
        Force minus reference [N], shape (N,); nan where the force did not follow.
    """
    known = np.isfinite(error)
    if not known.any():
        return None
    rms = float(np.sqrt(np.mean(error[known] ** 2)))
    worst = int(np.nanargmax(np.abs(error)))
    largest = abs(float(error[worst]))
    if largest <= OUTLIER * rms:
        return None
    time_s = recording.time_s
    at = f"at {time_s[worst]:.3f} s, {largest / rms:.1f} times the rms"
    recent = (time_s <= time_s[worst]) & (time_s >= time_s[worst] - NEAR_S)
    reason = _exchange_reason(recording, recent) or _course_reason(recording, error, known, recent, worst, rms)
    return f"{at}: {reason}"


def _exchange_reason(recording: Recording, recent: NDArray[np.bool_]) -> str:
    """Failed exchanges, missed ticks or a limit in a stretch; empty: none of them."""
    result, tick = recording.channels.get("result"), recording.channels.get("tick")
    if result is not None and (failed := recent & (result != ExchangeResult.OK)).any():
        name = ExchangeResult(int(result[failed][-1])).name.replace("_", " ")
        return f"{np.count_nonzero(failed)} exchanges before it failed, the last with {name}"
    if tick is not None and (lost := int(np.sum(np.diff(tick[recent]) - 1))) > 0:
        return f"{lost} ticks before it were missed"
    held = "a limit of voltage, slew or acceleration held the command back"
    return held if held_back(recording)[recent].any() else ""


def _course_reason(
    recording: Recording, error: Array, known: NDArray[np.bool_], recent: NDArray[np.bool_], worst: int, rms: float
) -> str:
    """Reason in the course of error and reference."""
    first = int(np.flatnonzero(known)[0])
    if recording.time_s[worst] - recording.time_s[first] < FIRST_S:
        return "the force had just begun to follow"
    beside = [abs(error[k]) for k in (worst - 1, worst + 1) if 0 <= k < error.size and known[k]]
    if beside and max(beside) < SPIKE * rms:
        return "a single sample; look for a disturbance of the load cell"
    reference = recording.channels.get("reference_N")
    turns = reference is not None and _turns(reference[recent])
    return "the reference turns there faster than the bench follows" if turns else "the recording shows no reason"


def _turns(values: Array) -> bool:
    steps = np.diff(values)
    moving = np.sign(steps[np.abs(steps) > 0.0])
    return bool((np.diff(moving) != 0).any())


def fact_rows(recording: Recording, error: Array | None) -> list[list[str]]:
    """Names and values of the facts that the recording knows.

    Parameters
    ----------
    error
        As for `outlier_reason`; None: the force has no reference.
    """
    said = recording.metadata
    rows = [[key, said[key]] for key in ("bench", "model", "limits") if said.get(key)]
    began = _began(recording)
    rows += [["began", began]] if began else []
    if kept := drifted_at(recording):
        rows.append(["model", f"DRIFTED at {kept}: the bench left its model"])
    tick = recording.channels.get("tick")
    if tick is not None and tick.size:
        due = int(tick[-1] - tick[0]) + 1
        missed = due - tick.size
        rows.append(["missed ticks", f"{missed} of {due} ({share_text(missed, due)})"])
    result = recording.channels.get("result")
    if result is not None and result.size:
        failed = int(np.count_nonzero(result != ExchangeResult.OK))
        rows.append(["failed exchanges", f"{failed} of {result.size} ({share_text(failed, result.size)})"])
    if "planned_V" in recording.channels:
        held = int(np.count_nonzero(held_back(recording)))
        rows.append(["held back by a limit", f"{held} of {recording.time_s.size} ticks"])
    reason = None if error is None else outlier_reason(recording, error)
    if error is not None and np.isfinite(error).any():
        rows.append(["largest error", reason or "no outlier"])
    return rows


def share_text(part: int, whole: int) -> str:
    """A share in per cent with two digits; "none" for 0.

    Parameters
    ----------
    part, whole
        Numbers of ticks; whole at least 1.
    """
    return "none" if not part else f"{100.0 * part / whole:.2g} %"


def drifted_at(recording: Recording) -> str:
    """Time at which the bench left its model during the run; empty if it did not, or if it is not known.

    The daemon keeps a recording of a drift. It belongs to the run if its date lies within the run.
    """
    kept, wall_s = Path(recording.metadata.get("drift_file", "")), recording.channels.get("wall_s")
    if wall_s is None or not kept.is_file():
        return ""
    try:
        recorded = read_recording(kept).metadata.get("recorded", "")
        at_s = datetime.fromisoformat(recorded).timestamp()
    except (RecordingError, ValueError):
        return ""
    inside = np.floor(wall_s[0]) <= at_s <= wall_s[-1] + 1.0  # the date has whole seconds
    return recorded if inside else ""


def _began(recording: Recording) -> str:
    wall_s = recording.channels.get("wall_s")
    if wall_s is not None and wall_s.size:
        return datetime.fromtimestamp(float(wall_s[0]), UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    return recording.metadata.get("recorded", recording.metadata.get("began", ""))
