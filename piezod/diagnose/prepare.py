"""Recordings and the given model made ready: equal steps, noise, starts, frozen readings, a stand-in for the past."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.clipped import clipped_note, clipped_stretches
from piezod.diagnose.candidates.direct import noise_of
from piezod.diagnose.candidates.frozen import frozen_stretches, still_stretches
from piezod.diagnose.candidates.rounding import lattice_step_N
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, Point, empty_point
from piezod.diagnose.hypothesis.series import Role, Series
from piezod.errors import RecordingError
from piezod.estimation.initial_state import estimate_path, start_at_zero, starts_at_rest
from piezod.estimation.unknown_past import unknown_past
from piezod.excitation import varying_triangles
from piezod.identify.layout import stated_layout
from piezod.identify.simulation import where
from piezod.identify.suitability import falls
from piezod.model import Model, file_sha256, run_chain
from piezod.recording import Hold, Recording, TextOptions, read_recording
from piezod.recording.conversion import in_units_of
from piezod.recording.formats.repairs import repair_notes
from piezod.recording.strays import without_strays

Array = NDArray[np.float64]

FEWEST_SAMPLES = 500
UNEVEN = 0.01  # of a step; beyond it a recording is resampled
MOST_MISSED = 1.5  # ticks a sample, beyond which the steps are no clock that skips a few
STAND_IN_SAMPLES = 6000  # of the excitation that stands for recordings which are no longer there
START_LOOKED_AT_S = 20.0
APART = 3.0  # noises between what may have been, above which it is not known
COPY = 0.9999  # correlation from which a column is another one in another unit


@dataclass(frozen=True)
class Source:
    """A recording as it was given.

    Parameters
    ----------
    recording
        Its channels.
    sha256
        Of the file.
    role
        Whether the model was identified on it.
    condition
        COLUMN=VALUE at which its readings count; None: everywhere.
    notes
        What was understood of its file, and each channel that was converted.
    text
        What the user says about a text file; None: nothing.
    """

    recording: Recording
    sha256: str
    role: Role
    condition: str | None = None
    notes: tuple[str, ...] = ()
    text: TextOptions | None = None

    @property
    def name(self) -> str:
        """Its file's name."""
        return Path(self.recording.source).name or self.recording.source


def read_source(
    path: Path, role: Role, columns: Sequence[str], condition: str | None = None, text: TextOptions | None = None
) -> Source:
    """Read a recording whole.

    Parameters
    ----------
    path
        File of any format.
    role
        What it is used for.
    columns
        Channels that are wanted; one that the file holds in another multiple of its unit is converted.
    condition
        COLUMN=VALUE at which its readings count; None: everywhere.
    text
        What the user says about a text file; None: everything is found from the file.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    recording, notes = in_units_of(read_recording(path, text), columns)
    if "understood" in recording.metadata:
        notes.insert(0, f"read as: {recording.metadata['understood']}")
    notes += repair_notes(recording.metadata)
    return Source(recording, file_sha256(path), role, condition, tuple(f"{path}: {note}" for note in notes), text)


def past_sources(model: Model, folder: Path, given: Sequence[Source]) -> tuple[list[Source], list[str]]:
    """The recordings that the model was identified on, where they are still there and the same.

    Parameters
    ----------
    model
        Its provenance names them.
    folder
        Of the model file; relative paths start there too.
    given
        Recordings asked about; one that the model was identified on is not taken twice.

    Returns
    -------
    sources, notes
        What was found, and a line for each that was not.
    """
    found, notes = [], []
    asked = {one.sha256 for one in given}
    for source in model.provenance.recordings:
        places = (Path(source.path), folder / source.path, folder / Path(source.path).name)
        path = next((one for one in places if one.is_file() and file_sha256(one) == source.sha256), None)
        if source.sha256 in asked:
            continue
        if path is None:
            notes.append(f"{source.path}, which the model was identified on, is not there or not the same any more")
        else:
            columns = (model.input.channel, model.output.channel)
            found.append(read_source(path, "identification", columns, text=stated_layout(source)))
    return found, notes


Stretches = list[tuple[int, int]]


def made_ready(sources: Sequence[Source], model: Model) -> tuple[list[Series], list[Stretches], list[str]]:
    """Recordings on equal steps, with columns for what an unknown past leaves, without frozen readings.

    Parameters
    ----------
    sources
        As they were given.
    model
        As it was identified.

    Returns
    -------
    series, frozen, notes
        The recordings, the stretches of each in which its readings stand still, and what was noticed.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    series: list[Series] = []
    frozen: list[Stretches] = []
    notes: list[str] = []
    for source in sources:
        one, more = even(source, model)
        one, unknown = with_unknown_start(started(one, model), model)
        one, clipped = without_clipped(one, model)
        one, stretches = without_frozen(one, model)
        series.append(one)
        frozen.append(stretches)
        notes += more + unknown + clipped
    return series, frozen, notes


def even(source: Source, model: Model) -> tuple[Series, list[str]]:
    """A recording on equal steps.

    Raises
    ------
    RecordingError
        It has not the model's columns, too few samples, or an input that is not known.
    UsageError
        The condition is none.
    """
    recording, strays = without_strays(source.recording, model.input.channel, model.output.channel)
    notes = [f"{source.name}: {line}" for line in strays]
    u, y = recording.channel(model.input.channel), recording.channel(model.output.channel)
    if u.size < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: has {u.size} samples, needs at least {FEWEST_SAMPLES} to be diagnosed"
        )
    if falls(recording, model.input.channel, model.output.channel):
        raise RecordingError(
            f"{recording.source}: {model.output.channel} falls where {model.input.channel} rises, in the model it "
            "rises: turn the sign of the load cell (registers.force.scale, or the column), or identify the bench anew"
        )
    steps = np.diff(recording.time_s)
    dt_s = float(np.median(steps))
    if np.max(np.abs(steps - dt_s)) > UNEVEN * dt_s:
        ticks = _ticks(recording.time_s, dt_s)
        if ticks is None:
            recording = recording.resampled(dt_s)
            notes.append(f"{source.name}: samples are not evenly spaced; resampled to {dt_s:.6g} s")
        else:
            recording = _on_every_tick(recording, ticks, model.input.channel)
            missed = recording.time_s.size - ticks.size
            notes.append(f"{source.name}: {missed} of {recording.time_s.size} samples are missing; they do not count")
        u, y = recording.channel(model.input.channel), recording.channel(model.output.channel)
    if not np.isfinite(u).all():
        recording, cut = _longest_stretch(recording, model.input.channel)
        u, y = recording.channel(model.input.channel), recording.channel(model.output.channel)
        notes.append(f"{source.name}: {cut}")
        if u.size < FEWEST_SAMPLES:
            raise RecordingError(
                f"{recording.source}: {model.input.channel} has {u.size} samples in its longest stretch without a "
                f"missing one, needs at least {FEWEST_SAMPLES} to be diagnosed"
            )
    temperature = _temperature_of(recording, model, notes)
    time_s = recording.time_s - recording.time_s[0]
    good = np.isfinite(y)
    if source.condition is not None:
        good = good & where(recording, source.condition)
    if np.count_nonzero(good) < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {model.output.channel} has {np.count_nonzero(good)} readings, needs {FEWEST_SAMPLES}"
        )
    readings = np.nan_to_num(y)
    noise = noise_of(u, readings, good)
    series = Series(
        source.name,
        source.role,
        time_s,
        np.ascontiguousarray(u),
        readings,
        good,
        noise,
        temperature_C=None if temperature is None else np.nan_to_num(temperature, nan=float(np.nanmedian(temperature))),
        start_s=float(recording.time_s[0]),
        lattice_N=lattice_step_N(readings[good]),
        recorded_hold=Hold.from_metadata(recording.metadata),
    )
    return series, notes


def _temperature_of(recording: Recording, model: Model, notes: list[str]) -> Array | None:
    """Temperature of the bench; None without one. The input, the output and a copy of them explain nothing."""
    own = (model.input.channel, model.output.channel)
    names = [name for name in ("temperature_C", "temperature_degC") if name in recording.channels and name not in own]
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
    """Number of every sample on a clock that skipped a few; None where there is no such clock."""
    steps = np.diff(time_s) / dt_s
    skipped = np.round(steps).astype(np.int64)
    numbers = np.concatenate(([0], np.cumsum(skipped)))
    steady = bool(np.max(np.abs(steps - skipped)) <= UNEVEN) and int(skipped.min()) > 0
    return numbers if steady and numbers[-1] < MOST_MISSED * numbers.size else None


def _on_every_tick(recording: Recording, ticks: NDArray[np.int64], held: str) -> Recording:
    """The same with every tick: where one was missed, the `held` channel stays as it was and all others are nan."""
    count = int(ticks[-1]) + 1
    time_s = np.linspace(recording.time_s[0], recording.time_s[-1], count)
    channels = {name: np.full(count, np.nan) for name in recording.channels}
    for name, values in recording.channels.items():
        channels[name][ticks] = values
    channels[held] = recording.channel(held)[np.searchsorted(ticks, np.arange(count), side="right") - 1]
    return Recording(time_s, channels, dict(recording.metadata), recording.source)


def _longest_stretch(recording: Recording, channel: str) -> tuple[Recording, str]:
    """The recording from one missing sample of a channel to the next, where that is farthest; and what was done."""
    missing = np.flatnonzero(~np.isfinite(recording.channel(channel)))
    edges = np.concatenate(([-1], missing, [recording.time_s.size]))
    widest = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[widest]) + 1, int(edges[widest + 1]))
    kept = Recording(
        recording.time_s[part],
        {name: one[part] for name, one in recording.channels.items()},
        recording.metadata,
        recording.source,
    )
    span_s = kept.time_s[-1] - kept.time_s[0]
    return (
        kept,
        f"{channel} has {missing.size} missing samples; the longest stretch without one, {span_s:.3g} s, is used",
    )


def stand_in(model: Model) -> Series:
    """A recording simulated from the model, for those it was identified on when they are gone.

    It has the effects that were there at the identification, and none that came since.
    """
    peak = model.input.high
    rate_Hz = STAND_IN_SAMPLES / 150.0
    u = varying_triangles(peak - min(model.input.low, 0.0), 0.1, 15, rate_Hz) + min(model.input.low, 0.0)
    time_s = np.arange(u.size) / rate_Hz
    y = run_chain(as_identified(model), model.operator(), time_s, u, temperature_C=np.zeros(u.size))
    errors = model.provenance.fit
    noise = errors.rms_fit or errors.rms_held_out or 1e-3 * float(np.ptp(y))
    return Series(
        "the model's own simulation", "identification", time_s, u, y, np.ones(u.size, bool), noise, hold=model.hold
    )


def as_identified(model: Model) -> Model:
    """The given model without what came after its identification."""
    then = tuple(one for one in model.effects if one.since == "identification")
    return model.model_copy(update={"effects": then, "unnamed_law": None})


def started(series: Series, model: Model) -> Series:
    """The same with the voltages that led to its start, under the model as it was given."""
    u, y = series.command_V, series.reading_N
    window = int(min(max(START_LOOKED_AT_S / series.dt_s, 0.2 * u.size), u.size))
    counts = series.counts[:window]
    if starts_at_rest(u):

        def loss(path: tuple[float, ...]) -> float:
            operator = model.hysteresis.operator()
            operator.run(np.array(path))
            error = (y[:window] - operator.run(u[:window]))[counts]
            return float(np.mean((error - np.median(error)) ** 2))

        return replace(series, path_V=start_at_zero(u[:window], model.input.unit, loss).path)
    operator = model.hysteresis.operator()
    known = np.where(series.counts, y, np.nan)
    return replace(series, path_V=estimate_path(operator, u, known - np.nanmedian(known - operator.run(u)), window))


def with_unknown_start(series: Series, model: Model) -> tuple[Series, list[str]]:
    """The same with columns for what was driven before a start amid the range, and what is said."""
    u = series.command_V
    if starts_at_rest(u):
        return series, []
    ends = model.input.low, model.input.high
    gain = (model.output.high - model.output.low) / (ends[1] - ends[0])
    longest = max(block.stop - block.start for block in series.blocks)
    past = unknown_past(u, model.hysteresis.operator, ends, APART * series.noise_N / gain, 2 * longest)
    if past is None:
        return replace(series, past_known=np.ones(u.size, bool)), []
    said = f"its first {past.until * series.dt_s:.3g} s depend on what came before, which is fitted"
    notes, known = [f"{series.name}: {said}"], past.known
    if not any(known[block].all() for block in series.blocks):
        notes.append(f"{series.name}: what came before matters to its end; drive the whole range once, then record")
        known = np.ones(u.size, bool)
    return replace(series, start_columns=past.columns, past_matters_until=past.until, past_known=known), notes


def without_clipped(series: Series, model: Model) -> tuple[Series, list[str]]:
    """The same without readings at the end of a converter's range, and a note on each end."""
    operator = model.hysteresis.operator()
    operator.run(np.array(series.path_V))
    expected = operator.run(series.command_V)
    readings = series.reading_N[series.counts]
    within = series.counts & (series.reading_N > readings.min()) & (series.reading_N < readings.max())
    tared = within if within.any() else series.counts  # what is clipped tells no tare
    expected += float(np.median((series.reading_N - expected)[tared]))
    found = clipped_stretches(series, expected, frozen_stretches(series, expected))
    counts = series.counts.copy()
    for first, end in (stretch for stretches in found.values() for stretch in stretches):
        counts[first:end] = False
    if not counts.any():
        return series, []
    notes = [clipped_note(series, limit_N, stretches, model.output.unit) for limit_N, stretches in found.items()]
    return replace(series, counts=counts), notes


def without_frozen(series: Series, model: Model) -> tuple[Series, list[tuple[int, int]]]:
    """The same without readings that are frozen, and where they are.

    Raises
    ------
    RecordingError
        All of them are.
    """
    operator = model.hysteresis.operator()
    operator.run(np.array(series.path_V))
    expected = operator.run(series.command_V)
    stretches = frozen_stretches(series, expected) or still_stretches(series, expected)
    stretches = [(first, end) for first, end in stretches if series.counts[first:end].any()]
    counts = series.counts.copy()
    for first, end in stretches:
        counts[first:end] = False  # the first one too: at a rail it is no reading
    if stretches and not counts.any():
        if np.ptp(series.reading_N[series.counts]) > 0.0:
            return series, []  # a few levels, each held for long: a coarse converter
        raise RecordingError(
            f"{series.name}: the reading stands still at {series.reading_N[0]:g} {model.output.unit} from the first "
            f"sample to the last, {series.duration_s:.3g} s; look at the sensor and its converter, then record again"
        )
    return replace(series, counts=counts), stretches


def chain_of(series: Sequence[Series], model: Model) -> tuple[Chain, Point]:
    """Recordings and a base to begin from."""
    low = min(float(one.command_V.min()) for one in series)
    high = max(float(one.command_V.max()) for one in series)
    swing = high - low
    rested = any(starts_at_rest(one.command_V) for one in series)  # and may have been virgin, whatever its path says
    reach = 0.995 * (max(abs(low), abs(high)) if rested else 0.5 * swing)
    law = ForceLaw(low - 0.03 * swing, high)
    spans = model.output.high - model.output.low, model.input.high - model.input.low
    asked = [one for one in series if one.role == "recording"] or series
    seen_s = model.seen_s or max(one.duration_s for one in asked)
    chain = Chain(series, PlayDensity.up_to(reach), law, spans[0], voltage_span_V=spans[1], seen_s=seen_s)
    gain = (model.output.high - model.output.low) / (model.input.high - model.input.low)
    return chain, empty_point(chain, gain, model.output.low - gain * model.input.low)


__all__ = [
    "Source",
    "as_identified",
    "chain_of",
    "even",
    "made_ready",
    "noise_of",
    "past_sources",
    "read_source",
    "stand_in",
    "started",
    "with_unknown_start",
    "without_frozen",
]
