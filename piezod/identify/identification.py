"""From recordings to a model: prepare, judge the orders, fit, and say how good it is."""

import contextlib
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import RecordingError, UsageError
from piezod.estimation.columns import Samples, Structure
from piezod.estimation.initial_state import settled_from, start_at_zero, starts_at_rest
from piezod.estimation.quadratic_program import Variant
from piezod.estimation.thresholds import dead_zone_thresholds, play_reach, play_thresholds, widest
from piezod.identify.fit import fit_hysteresis
from piezod.identify.intake import OnStep
from piezod.identify.order import PLAYS, ZONES, Candidate, best_of, choose, judge_orders, prune, residual
from piezod.identify.scores import largest, max_hysteresis_percent, nrmse_percent, rms
from piezod.identify.suitability import FEWEST_SAMPLES, check_suitable
from piezod.model import Model, file_sha256
from piezod.model.parameters import Channel, FitFigures, Provenance, RecordingSource, Start
from piezod.operators import EPS
from piezod.recording import Recording

Array = NDArray[np.float64]

START_SAMPLES = 100_000  # looked at to find how a drive that begins at zero was used before
START_ORDERS = (11, 3)


@dataclass(frozen=True)
class Options:
    """How to identify.

    Parameters
    ----------
    input, output
        Columns of the recordings.
    plays, zones
        n and m; None: judged by the held-out error.
    variant
        "A": no play weight negative; "B": no partial sum below eps.
    eps
        Smallest partial sum.
    prune
        Whether operators that hardly matter are dropped.
    fit_share
        Leading share of each recording that is fitted; the rest is held out.
    name
        Of the model.
    """

    input: str = "voltage_V"
    output: str = "force_N"
    plays: int | None = None
    zones: int | None = None
    variant: Variant = "B"
    eps: float = EPS
    prune: bool = True
    fit_share: float = 0.7
    name: str = "stack"


@dataclass(frozen=True)
class Identification:
    """A model and how it was come by.

    Parameters
    ----------
    model
        The chosen one.
    candidates
        Every pair of orders that was judged.
    taken
        The pair of orders that was taken.
    chosen
        The same after pruning: what the model was made of.
    notes
        What the recordings cannot determine, and what was noticed in them.
    """

    model: Model
    candidates: list[Candidate]
    taken: Candidate
    chosen: Candidate
    notes: list[str]


def identify(
    recordings: Sequence[Recording],
    options: Options,
    by: str,
    *,
    sources: Sequence[RecordingSource] = (),
    notes: Sequence[str] = (),
    on_step: OnStep = lambda *_: None,
) -> Identification:
    """Identify a model.

    Parameters
    ----------
    recordings
        At least one, all with the same input and output columns; such as `load_recordings` gives.
    options
        Columns, orders, constraints.
    by
        Program and version, for the provenance.
    sources, notes
        What taking them in found; without sources the recordings' files are hashed here.
    on_step
        Called with what is done and the share of the pairs of orders that is judged.

    Raises
    ------
    RecordingError
        A recording determines no model; the message says what to record instead.
    """
    pairs = [(r.channel(options.input), r.channel(options.output)) for r in recordings]
    said = [*notes, *(w for one in recordings for w in check_suitable(one, options.input, options.output))]
    if not 0.1 <= options.fit_share <= 0.95:
        raise UsageError(f"the fitted share is {options.fit_share:g}, must be within 0.1 and 0.95")
    on_step("fitting", 0.0)
    stretches = [_stretch(recording, u, y, options) for recording, (u, y) in zip(recordings, pairs, strict=True)]
    fitted, held_out = [one.fitted for one in stretches], [one.held_out for one in stretches]
    orders = [
        (n, m)
        for n in ((options.plays,) if options.plays is not None else PLAYS)
        for m in ((options.zones,) if options.zones is not None else ZONES)
    ]
    structures = _Structures(stretches)
    judged = itertools.count()

    def structure_of(plays: int, zones: int) -> Structure:
        on_step("fitting", next(judged) / len(orders))
        return structures.of(plays, zones)

    candidates = judge_orders(structure_of, fitted, held_out, orders=orders, variant=options.variant, eps=options.eps)
    taken = chosen = choose(candidates)
    if options.prune:
        chosen = prune(taken, best_of(candidates), fitted, held_out, variant=options.variant, eps=options.eps)
    model = _model(recordings, pairs, options, chosen, fitted, held_out, by, sources, said)
    said += [note for one in stretches for note in one.notes]
    return Identification(model, candidates, taken, chosen, said + _undetermined(chosen))


@dataclass(frozen=True)
class _Stretch:
    """One recording: what is fitted, what is held out, and how it starts."""

    fitted: Samples
    held_out: Samples
    at_rest: bool
    notes: tuple[str, ...]


def _stretch(recording: Recording, u: Array, y: Array, options: Options) -> _Stretch:
    """Which samples are fitted and which are held out, and what the memory starts with."""
    counts = np.isfinite(y)
    clock: Array | None = None
    path: tuple[float, ...]
    boundary = int(options.fit_share * u.size)
    at_rest = starts_at_rest(u)
    notes = []
    if at_rest:
        counted = counts.copy()
        counted[boundary:] = False
        start = start_at_zero(u, _unit(options.input), _loss_of_start(u, y, counted))
        path = start.path
        if path:
            notes.append(f"{recording.source}: the stack was {start.words}; that is what its memory starts with")
    else:
        first = settled_from(u)
        counts[:first] = False
        path = (float(u[0]),)
        clock = (recording.time_s - recording.time_s[boundary]) / (recording.time_s[boundary] - recording.time_s[0])
        notes.append(
            f"{recording.source}: does not start at rest; its first "
            f"{recording.time_s[first] - recording.time_s[0]:.3g} s are not used, "
            "and plays wider than half its swing stay unknown"
        )
    inside, outside = counts.copy(), counts.copy()
    inside[boundary:], outside[:boundary] = False, False
    if inside.sum() < FEWEST_SAMPLES or outside.sum() < FEWEST_SAMPLES:
        raise RecordingError(
            f"{recording.source}: {inside.sum()} samples to fit and {outside.sum()} to hold out are too few; "
            "record at least three periods"
        )
    fitted = Samples(u, np.nan_to_num(y), inside, clock, path)
    return _Stretch(fitted, replace(fitted, counts=outside), at_rest, tuple(notes))


def _loss_of_start(u: Array, y: Array, counts: NDArray[np.bool_]) -> Callable[[tuple[float, ...]], float]:
    """Mean square error in the output of a middling structure, as a function of the start path."""
    part = slice(None, None, max(1, u.size // START_SAMPLES))  # a start shows over the whole first rise
    u, y, counts = u[part], np.nan_to_num(y[part]), counts[part]
    if not np.ptp(u) > 0.0 or counts.sum() < FEWEST_SAMPLES:
        return lambda path: 0.0 if not path else np.inf

    def loss(path: tuple[float, ...]) -> float:
        samples = Samples(u, y, counts, None, path)
        structure = _Structures([_Stretch(samples, samples, at_rest=True, notes=())]).of(*START_ORDERS)
        error = residual(fit_hysteresis(structure, [samples]).hysteresis.operator(), samples)
        return float(np.mean(error[counts] ** 2))

    return loss


class _Structures:
    """Thresholds for any orders, from the range that all recordings cover."""

    def __init__(self, stretches: Sequence[_Stretch]) -> None:
        parts = [stretch.fitted for stretch in stretches]
        known = [
            samples.y[one.fitted.counts | one.held_out.counts] for samples, one in zip(parts, stretches, strict=True)
        ]
        reaches = [
            play_reach(samples.u, samples.path, at_rest=one.at_rest)
            for samples, one in zip(parts, stretches, strict=True)
        ]
        self._reach = widest(reaches)
        self._u_max = max(float(np.abs(samples.u).max()) for samples in parts)
        self._low = min(float(y.min()) for y in known)
        self._high = max(float(y.max()) for y in known)
        self._origin = float(known[0][0]) if stretches[0].at_rest else self._low
        self._swing = max(float(np.ptp(samples.u)) for samples in parts)

    def of(self, plays: int, zones: int) -> Structure:
        """Thresholds for n plays and m dead zones."""
        return Structure(
            play_thresholds(plays, self._reach.end, beyond=self._reach.beyond),
            dead_zone_thresholds(zones, self._low - self._origin, self._high - self._origin),
            self._origin,
            self._u_max,
            self._swing / (self._high - self._low),
        )


def _model(
    recordings: Sequence[Recording],
    pairs: Sequence[tuple[Array, Array]],
    options: Options,
    chosen: Candidate,
    fitted: Sequence[Samples],
    held_out: Sequence[Samples],
    by: str,
    sources: Sequence[RecordingSource],
    notes: Sequence[str],
) -> Model:
    assert chosen.fit is not None
    sources = tuple(sources) or tuple(
        RecordingSource(path=r.source, sha256=file_sha256(Path(r.source)), samples=int(r.time_s.size))
        for r in recordings
        if Path(r.source).is_file()
    )
    return Model(
        name=options.name,
        input=_channel(options.input, [u for u, _ in pairs]),
        output=_channel(options.output, [y for _, y in pairs]),
        hysteresis=chosen.fit.hysteresis,
        start=_start(fitted[0].path, at_rest=starts_at_rest(fitted[0].u)),
        provenance=Provenance(
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            by=by,
            recordings=sources,
            fit=_figures(chosen, fitted, held_out),
            notes="; ".join(notes),
        ),
        statistics=chosen.fit.statistics,
    )


def _start(path: tuple[float, ...], *, at_rest: bool) -> Start:
    """What a drive from zero starts with, when it starts as the first recording did."""
    if at_rest and path:
        return Start(kind="reset", peak=float(f"{path[0]:.6g}"))
    return Start()


def _channel(name: str, values: Sequence[Array]) -> Channel:
    low = min(float(np.nanmin(v)) for v in values)
    high = max(float(np.nanmax(v)) for v in values)
    return Channel(channel=name, unit=_unit(name), low=low, high=high)


def _unit(column: str) -> str:
    return column.rpartition("_")[2] or column


def _figures(chosen: Candidate, fitted: Sequence[Samples], held_out: Sequence[Samples]) -> FitFigures:
    """Figures on fit and held-out data, side by side."""
    assert chosen.fit is not None
    operator = chosen.fit.hysteresis.operator()
    figures: dict[str, float | None] = {}
    for name, stretches in (("fit", fitted), ("held_out", held_out)):
        errors = [residual(operator, samples)[samples.counts] for samples in stretches]
        outputs = [samples.y[samples.counts] for samples in stretches]
        inputs = [samples.u[samples.counts] for samples in stretches]
        modelled = [y - error for y, error in zip(outputs, errors, strict=True)]
        measured, error = np.concatenate(outputs), np.concatenate(errors)
        figures[f"rms_{name}"] = rms(error)
        figures[f"max_{name}"] = largest(error)
        figures[f"nrmse_percent_{name}"] = nrmse_percent(measured, measured - error)
        figures[f"max_hysteresis_percent_{name}"] = _widest_loop(inputs, outputs)
        figures[f"remaining_hysteresis_percent_{name}"] = _widest_loop(modelled, outputs)
    return FitFigures(**{key: value if value is None else float(f"{value:.6g}") for key, value in figures.items()})


def _widest_loop(drives: Sequence[Array], responses: Sequence[Array]) -> float | None:
    """Max hysteresis of the recordings, None where none of them closes a loop."""
    openings = []
    for drive, response in zip(drives, responses, strict=True):
        with contextlib.suppress(ValueError):
            openings.append(max_hysteresis_percent(drive, response))
    return max(openings, default=None)


def _undetermined(chosen: Candidate) -> list[str]:
    """Slopes whose column is nearly empty: the recording hardly reaches there."""
    assert chosen.fit is not None
    gram, structure = chosen.fit.gram, chosen.fit.structure
    lengths = np.sqrt(np.diag(gram)[: structure.plays])
    weak = np.flatnonzero(lengths < 1e-3 * lengths.max())
    return [f"plays above {structure.play_thresholds[k]:.3g} are hardly moved by these recordings" for k in weak[:1]]
