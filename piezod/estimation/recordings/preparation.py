"""Preparation of the recordings: equal time steps, initial state, and exclusion of clipped and frozen readings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.estimation.recordings.chosen_samples import where
from piezod.estimation.recordings.converter import converter_step_N
from piezod.estimation.recordings.frozen import frozen_stretches, still_stretches
from piezod.estimation.recordings.intake import TEMPERATURES
from piezod.estimation.recordings.noise import white_noise_of
from piezod.estimation.recordings.series import Series
from piezod.estimation.recordings.sources import Source
from piezod.estimation.recordings.start import (
    START_WINDOW_S,
    estimate_path,
    loss_of_start,
    output_after,
    start_at_zero,
    starts_at_rest,
    tared_mean_square,
)
from piezod.estimation.recordings.strays import without_strays
from piezod.estimation.recordings.suitability import falls
from piezod.estimation.recordings.unknown_past import unknown_past
from piezod.model import Model
from piezod.recording import Recording
from piezod.recording.hold import Hold
from piezod.recording.stretches import stretches_of

MOST_SAMPLES = 300_000
"""Of a recording in a diagnosis, which then takes a gigabyte and two minutes of processor. The errors of simulations
are of all samples."""
FEWEST_SAMPLES = 500  # a shorter recording has too few samples for the blocks that are left out
UNEVEN = 0.01  # largest relative deviation of a time step; beyond it the recording is resampled
MOST_MISSED = 1.5  # largest number of clock ticks per sample if samples are missing; beyond it there is no such clock
SIGNIFICANT_PAST = 3.0  # difference between possible pasts above which the history matters [noise rms]
COPY = 0.9999  # correlation above which a temperature column is a copy of another channel
FEWEST_CLIPPED = 3  # stretches at an extreme reading that make it a limit: a sensor hardly freezes there repeatedly
# largest of nine in ten steps of the reading, times this, is a jump: after a freeze the reading jumps to where it
# would be, a limit is entered and left by a usual step
JUMP = 2.0


def prepared(sources: Sequence[Source], model: Model) -> list[Series]:
    """Series of the recordings, each with its initial state, its frozen stretches and its notes.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    all_series = []
    for source in sources:
        series = with_start(evenly_spaced(source, model), model)
        series = with_unknown_start(series, model)
        all_series.append(without_frozen(without_clipped(series, model), model))
    return all_series


def evenly_spaced(source: Source, model: Model) -> Series:
    """Series of a recording on equal time steps.

    Raises
    ------
    RecordingError
        The recording lacks a channel of the model or has too few samples.
    UsageError
        The condition is invalid.
    """
    recording, strays = without_strays(source.recording, model.input.channel, model.output.channel)
    notes = [f"{source.name}: {line}" for line in strays]
    size = recording.channel(model.input.channel).size
    recording.channel(model.output.channel)
    if size < FEWEST_SAMPLES:
        raise RecordingError(f"{recording.source}: has {size} samples, needs at least {FEWEST_SAMPLES} to be diagnosed")
    if falls(recording, model.input.channel, model.output.channel):
        raise RecordingError(
            f"{recording.source}: {model.output.channel} falls where {model.input.channel} rises, in the model it "
            "rises: turn the sign of the load cell (registers.force.scale, or the column), or identify the bench anew"
        )
    recording, resampled = _on_equal_steps(recording, model.input.channel)
    recording, cut = _without_input_gaps(recording, model.input.channel)
    recording, shortened = _shortened(recording, model.input.channel)
    notes += [f"{source.name}: {line}" for line in resampled + cut + shortened]
    u, y = recording.channel(model.input.channel), recording.channel(model.output.channel)
    temperature = _temperature_of(recording, model, notes)
    good = np.isfinite(y)
    if source.condition is not None:
        good = good & where(recording, source.condition)
    if np.count_nonzero(good) < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {model.output.channel} has {np.count_nonzero(good)} readings, needs {FEWEST_SAMPLES}"
        )
    readings = np.nan_to_num(y)
    return Series(
        source.name,
        source.role,
        recording.time_s - recording.time_s[0],
        np.ascontiguousarray(u),
        readings,
        good,
        white_noise_of(u, readings, good),
        temperature_C=None if temperature is None else np.nan_to_num(temperature, nan=float(np.nanmedian(temperature))),
        start_s=float(recording.time_s[0]),
        lattice_N=converter_step_N(readings[good]),
        recorded_hold=Hold.from_metadata(recording.metadata),
        notes=tuple(notes),
    )


def _on_equal_steps(recording: Recording, held: str) -> tuple[Recording, list[str]]:
    """Recording with equal time steps: missing samples inserted (`held` channel held), or resampled; and notes."""
    steps = np.diff(recording.time_s)
    dt_s = float(np.median(steps))
    if np.max(np.abs(steps - dt_s)) <= UNEVEN * dt_s:
        return recording, []
    ticks = _ticks(recording.time_s, dt_s)
    if ticks is None:
        return recording.resampled(dt_s), [f"samples are not evenly spaced; resampled to {dt_s:.6g} s"]
    recording = _on_every_tick(recording, ticks, held)
    missed = recording.time_s.size - ticks.size
    return recording, [f"{missed} of {recording.time_s.size} samples are missing; they do not count"]


def _without_input_gaps(recording: Recording, channel: str) -> tuple[Recording, list[str]]:
    """Longest part of a recording without a missing sample of its input, and notes."""
    known = np.isfinite(recording.channel(channel))
    if known.all():
        return recording, []
    first, end = max(stretches_of(known), key=lambda part: part[1] - part[0], default=(0, 0))
    longest = recording.part(slice(first, end))
    if longest.time_s.size < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {channel} has {longest.time_s.size} samples in its longest stretch without a "
            f"missing one, needs at least {FEWEST_SAMPLES} to be diagnosed"
        )
    span_s = longest.time_s[-1] - longest.time_s[0]
    missing = np.count_nonzero(~known)
    note = f"{channel} has {missing} missing samples; the longest stretch without one, {span_s:.3g} s, is used"
    return longest, [note]


def _shortened(recording: Recording, channel: str) -> tuple[Recording, list[str]]:
    """First `MOST_SAMPLES` of a long recording, from its first motion on, and a note."""
    size, u = recording.time_s.size, recording.channel(channel)
    if size <= MOST_SAMPLES:
        return recording, []
    rest = int(np.argmax(u != u[0]))
    first = min(max(rest - FEWEST_SAMPLES, 0), size - MOST_SAMPLES)
    part = recording.part(slice(first, first + MOST_SAMPLES))
    note = (
        f"has {size} samples; effects are looked for in {MOST_SAMPLES} of them, from {part.time_s[0]:.6g} to "
        f"{part.time_s[-1]:.6g} s, and the errors are of all; for slower effects, give every tenth row or so"
    )
    return part, [note]


def _temperature_of(recording: Recording, model: Model, notes: list[str]) -> Array | None:
    """Temperature of the bench; None if there is no column, or only the input, the output or a copy."""
    own = (model.input.channel, model.output.channel)
    names = [name for name in TEMPERATURES if name in recording.channels and name not in own]
    for name in names:
        values = recording.channels[name]
        known = np.isfinite(values)
        for other in own:
            compared = known & np.isfinite(recording.channel(other))
            pair = values[compared], recording.channel(other)[compared]
            if compared.any() and min(map(np.ptp, pair)) > 0.0 and abs(np.corrcoef(*pair)[0, 1]) > COPY:
                notes.append(f"{recording.source}: {name} is a copy of {other}, no temperature; it is not used")
                break
        else:
            return np.asarray(values, dtype=np.float64)
    return None


def _ticks(time_s: Array, dt_s: float) -> NDArray[np.int64] | None:
    """Tick number of every sample on a clock that skips a few ticks; None if the times fit no such clock."""
    steps = np.diff(time_s) / dt_s
    skipped = np.round(steps).astype(np.int64)
    numbers = np.concatenate(([0], np.cumsum(skipped)))
    steady = bool(np.max(np.abs(steps - skipped)) <= UNEVEN) and int(skipped.min()) > 0
    return numbers if steady and numbers[-1] < MOST_MISSED * numbers.size else None


def _on_every_tick(recording: Recording, ticks: NDArray[np.int64], held: str) -> Recording:
    """Recording with a sample at every tick; at a missing one the `held` channel keeps its value, others are nan."""
    count = int(ticks[-1]) + 1
    time_s = np.linspace(recording.time_s[0], recording.time_s[-1], count)
    channels = {name: np.full(count, np.nan) for name in recording.channels}
    for name, values in recording.channels.items():
        channels[name][ticks] = values
    channels[held] = recording.channel(held)[np.searchsorted(ticks, np.arange(count), side="right") - 1]
    return Recording(time_s, channels, dict(recording.metadata), recording.source)


def with_start(series: Series, model: Model) -> Series:
    """Series with its initial state, estimated under the given model."""
    u, y = series.command_V, series.reading_N
    window = int(min(max(START_WINDOW_S / series.dt_s, 0.2 * u.size), u.size))
    operator = model.hysteresis.operator()
    if starts_at_rest(u):
        begin = u[:window]
        loss = loss_of_start(
            lambda path: output_after(operator, path, begin), y[:window], series.counts[:window], tared_mean_square
        )
        return replace(series, path_V=start_at_zero(begin, model.input.unit, loss).path)
    known = np.where(series.counts, y, np.nan)
    return replace(series, path_V=estimate_path(operator, u, known - np.nanmedian(known - operator.run(u)), window))


def with_unknown_start(series: Series, model: Model) -> Series:
    """Series with columns for its unknown past if it starts amid the range."""
    u = series.command_V
    if starts_at_rest(u):
        return series
    ends = model.input.low, model.input.high
    gain = (model.output.high - model.output.low) / (ends[1] - ends[0])
    longest = max(block.stop - block.start for block in series.blocks)
    least_V = SIGNIFICANT_PAST * series.noise_N / gain
    past = unknown_past(u, model.hysteresis.operator, ends, least_V, 2 * longest)
    if past is None:
        return replace(series, past_known=np.ones(u.size, bool))
    fitted_s = past.until * series.dt_s
    notes = [*series.notes, f"{series.name}: its first {fitted_s:.3g} s depend on what came before, which is fitted"]
    known = past.known
    if not any(known[block].all() for block in series.blocks):
        notes.append(f"{series.name}: what came before matters to its end; drive the whole range once, then record")
        known = np.ones(u.size, bool)
    series = replace(series, start_columns=past.columns, past_matters_until=past.until, past_known=known)
    return replace(series, notes=tuple(notes))


def without_clipped(series: Series, model: Model) -> Series:
    """Series without readings at a limit of the converter's range."""
    expected = output_after(model.hysteresis.operator(), series.path_V, series.command_V)
    readings = series.reading_N[series.counts]
    within = series.counts & (series.reading_N > readings.min()) & (series.reading_N < readings.max())
    tared = within if within.any() else series.counts  # clipped readings do not determine the tare
    expected += float(np.median((series.reading_N - expected)[tared]))
    clipped = _clipped_stretches(series, expected, frozen_stretches(series, expected))
    counts = series.counts.copy()
    for first, end in (stretch for stretches in clipped.values() for stretch in stretches):
        counts[first:end] = False
    if not counts.any():
        return series
    notes = [_clipped_note(series, limit_N, stretches, model.output.unit) for limit_N, stretches in clipped.items()]
    return replace(series, counts=counts, notes=(*series.notes, *notes))


def without_frozen(series: Series, model: Model) -> Series:
    """Series without frozen readings.

    Raises
    ------
    RecordingError
        All readings are frozen.
    """
    expected = output_after(model.hysteresis.operator(), series.path_V, series.command_V)
    stretches = frozen_stretches(series, expected) or still_stretches(series, expected)
    stretches = [(first, end) for first, end in stretches if series.counts[first:end].any()]
    counts = series.counts.copy()
    for first, end in stretches:
        counts[first:end] = False  # the first reading may be a limit of the converter
    if stretches and not counts.any():
        if np.ptp(series.reading_N[series.counts]) > 0.0:
            return series  # a coarse converter holds each of a few levels
        raise RecordingError(
            f"{series.name}: the reading stands still at {series.reading_N[0]:g} {model.output.unit} from the first "
            f"sample to the last, {series.duration_s:.3g} s; look at the sensor and its converter, then record again"
        )
    return replace(series, counts=counts, frozen=tuple(stretches))


def _clipped_stretches(
    series: Series, model_N: Array, stretches: Sequence[tuple[int, int]]
) -> dict[float, list[tuple[int, int]]]:
    """Clipped stretches (first, end) by their limit [N].

    A limit is the highest or the lowest reading. At least `FEWEST_CLIPPED` stretches are there in which the model lies
    mostly beyond it, or the reading enters and leaves one without a jump. Then all runs of readings at the limit in
    which the model lies beyond it are clipped.

    `model_N`: expected readings, shape (N,) [N]; `stretches`: stretches (first, end) of equal readings.
    """
    readings = series.reading_N[series.counts]
    clipped: dict[float, list[tuple[int, int]]] = {}
    for limit_N, side in ((float(readings.max()), 1.0), (float(readings.min()), -1.0)):
        at_limit = [(first, end) for first, end in stretches if series.reading_N[first] == limit_N]
        continuous = [stretch for stretch in at_limit if not _jumps(series, *stretch)]
        if continuous or len(_beyond(at_limit, side * model_N, side * limit_N)) >= FEWEST_CLIPPED:
            runs = stretches_of(series.reading_N == limit_N)
            clipped[limit_N] = sorted({*continuous, *_beyond(runs, side * model_N, side * limit_N)})
    return clipped


def _jumps(series: Series, first: int, end: int) -> bool:
    """Whether the reading jumps where the stretch begins or ends, or whether one of both was not recorded."""
    y = series.reading_N
    if first == 0 or end == y.size or not (series.counts[first - 1] and series.counts[end]):
        return True
    steps = np.abs(np.diff(y[series.counts]))
    usual_N = JUMP * float(np.quantile(steps[steps > 0.0], 0.9))
    return bool(max(abs(y[first] - y[first - 1]), abs(y[end] - y[end - 1])) > usual_N)


def _beyond(stretches: Sequence[tuple[int, int]], model_N: Array, limit_N: float) -> list[tuple[int, int]]:
    """Stretches in which the model is beyond the limit for most of the time."""
    return [(first, end) for first, end in stretches if np.mean(model_N[first:end] > limit_N) > 0.5]


def _clipped_note(series: Series, limit_N: float, stretches: Sequence[tuple[int, int]], unit: str) -> str:
    """Note about clipped stretches of a recording at a limit; `unit`: unit of the readings."""
    samples = sum(end - first for first, end in stretches)
    begin_s, end_s = (float(series.time_s[at]) + series.start_s for at in (stretches[0][0], stretches[-1][1] - 1))
    return (
        f"{series.name}: clipped at {limit_N:.6g} {unit}, {samples} samples in {len(stretches)} stretches from "
        f"{begin_s:.3g} to {end_s:.3g} s; they do not count: record with a larger range"
    )
