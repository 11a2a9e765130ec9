"""From recordings to a model: check the recordings, select the orders, and describe the result."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.errors import UsageError
from piezod.estimation.fit.columns import Samples
from piezod.estimation.fit.linear_dynamics import dynamics_words
from piezod.estimation.recordings.intake import OnStep
from piezod.estimation.recordings.layout import entry_of
from piezod.estimation.recordings.noise import Noise, noise_of
from piezod.estimation.recordings.suitability import check_suitable, falls
from piezod.identify.dynamics import hysteresis_and_dynamics
from piezod.identify.options import Options
from piezod.identify.order import Candidate
from piezod.identify.selection import Selection, reduce_smooth_base, select_by_orders
from piezod.model import Model, file_sha256
from piezod.model.parameters import Channel, Provenance, RecordingSource, Start
from piezod.recording import Recording
from piezod.recording.names import unit_of

LEAST_EXPLAINED = 0.5  # share of the output's variance that a useful model must explain
STRUCTURED = 3.0  # error, in multiples of the noise, above which an unusable model still has structured residuals
LARGEST_RATIO = 0.5  # largest ratio of the errors with and without linear dynamics at which they are kept
AT_THE_NOISE = 1.1  # error, in multiples of the noise, up to which no effect is missing: the noise is known to 5 %


@dataclass(frozen=True)
class Identification:
    """A model with the steps that led to it.

    Parameters
    ----------
    candidates
        Compared orders; empty after a fit of the smooth base.
    before_pruning, chosen
        Selected order, and the order of the model after pruning.
    notes
        Properties that the recordings do not determine, and properties of the recordings.
    noise
        Noise of the recordings; None: unknown.
    """

    model: Model
    candidates: list[Candidate]
    before_pruning: Candidate
    chosen: Candidate
    notes: list[str]
    noise: Noise | None = None

    @property
    def explained(self) -> float:
        """Explained share of the variance on held-out data, at most 1; below 0: worse than the mean."""
        fit = self.model.provenance.fit
        return 1.0 - (1.0 - 0.01 * (fit.nrmse_percent_held_out or 0.0)) ** 2

    @property
    def useful(self) -> bool:
        """Whether the model explains more than half of the variance."""
        return self.explained > LEAST_EXPLAINED

    @property
    def verdict(self) -> str:
        """Quality of the model in a sentence."""
        unit = self.model.output.unit
        error = self.chosen.rms_held_out
        share = 100.0 * error / (self.model.output.high - self.model.output.low)
        words = (
            f"error on held-out data {error:.3g} {unit} rms, {share:.2g} % of range; the model explains "
            f"{100.0 * self.explained:.4g} % of the output's variance"
        )
        if self.useful and self.noise is not None:
            rest = (
                "nothing else is left"
                if error < AT_THE_NOISE * self.noise.rms
                else "piezod diagnose tells what is left"
            )
            return f"{words}; noise {self.noise.rms:.3g} {unit}, seen in {self.noise.seen_in}; {rest}"
        if self.useful:
            return words
        needs = f"not usable: {words}, must explain more than {100.0 * LEAST_EXPLAINED:.0f} %"
        if self.noise is not None and error > STRUCTURED * self.noise.rms:
            return (
                f"{needs}; noise {self.noise.rms:.3g} {unit}, seen in {self.noise.seen_in}: what is left follows the "
                "input through modes, filters or delays, which no hysteresis has; piezod diagnose finds them"
            )
        return (
            f"{needs}; check that both columns "
            "belong together, or record triangles over the whole range (piezod record --excitation varying-triangles)"
        )


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
        At least one, as returned by `load_recordings`; all hold both columns of the options.
    by
        Program and version, for the provenance.
    sources
        Entries for the provenance; empty: computed from the recordings' files.
    notes
        Notes on the recordings, which precede those of the identification.
    on_step
        Called with the current step in words, and the share of the orders that is done; None: unknown.

    Raises
    ------
    RecordingError
        A recording determines no model; the message names a suitable recording.
    UsageError
        `fit_share` is out of range.
    """
    lines = list(notes)
    if all(falls(recording, options.input, options.output) for recording in recordings):
        lines.append(
            f"{recordings[0].source}: {options.output} falls where {options.input} rises: the model is of the negative "
            f"-{options.output}; to drive the bench, turn the sign of the load cell (registers.force.scale) and record "
            "again"
        )
        options = replace(options, output=f"-{options.output}")
    pairs = [(r.channel(options.input), r.channel(options.output)) for r in recordings]
    lines += [warning for r in recordings for warning in check_suitable(r, options.input, options.output)]
    if not 0.1 <= options.fit_share <= 0.95:
        raise UsageError(f"the fitted share is {options.fit_share:g}, must be within 0.1 and 0.95")
    on_step("fitting", 0.0 if options.by_orders else None)
    if options.by_orders:
        selection = select_by_orders(recordings, pairs, options, on_step)
    else:
        selection = reduce_smooth_base(recordings, pairs, options)
    stretch_notes = [note for stretch in selection.stretches for note in stretch.notes]
    model_notes = lines if options.by_orders else lines + stretch_notes
    model = _model(recordings, pairs, options, selection, by, sources, model_notes)
    static = Identification(
        model,
        selection.candidates,
        selection.before_pruning,
        selection.chosen,
        [*lines, *stretch_notes, *_undetermined(selection.chosen)],
        _noise(recordings, [stretch.fitted for stretch in selection.stretches]),
    )
    if static.useful or options.by_orders:
        return static
    on_step("fitting linear dynamics", None)
    return _with_dynamics(static, recordings, options) or static


def _with_dynamics(static: Identification, recordings: Sequence[Recording], options: Options) -> Identification | None:
    """Identification with linear dynamics; None: the error stays above half of the static error."""
    pairs = [(r.channel(options.input), r.channel(options.output)) for r in recordings]
    noise = static.noise.rms if static.noise is not None else static.chosen.rms_held_out
    both = hysteresis_and_dynamics(recordings, pairs, options, noise)
    if both is None or both.selection.chosen.rms_held_out > LARGEST_RATIO * static.chosen.rms_held_out:
        return None
    selection = both.selection
    provenance = static.model.provenance.model_copy(update={"fit": both.figures})
    model = static.model.model_copy(
        update={
            "hysteresis": both.hysteresis,
            "unnamed_law": both.law,
            "start": _start(selection.stretches[0].fitted.path, at_rest=selection.stretches[0].at_rest),
            "provenance": provenance,
        }
    )
    modes = [(mode.frequency_Hz, mode.damping_ratio) for mode in both.law.modes]
    parts = dynamics_words(modes, [memory_s for memory_s in both.law.memories_s if memory_s > 0.0])
    note = f"the output follows linear dynamics in addition to the hysteresis: {parts}"
    return replace(
        static,
        model=model,
        before_pruning=selection.before_pruning,
        chosen=selection.chosen,
        notes=[*static.notes, note],
        noise=_noise(recordings, [stretch.fitted for stretch in selection.stretches]) or static.noise,
    )


def _noise(recordings: Sequence[Recording], fitted: Sequence[Samples]) -> Noise | None:
    """Rms noise over the recordings whose noise is known."""
    noises = [noise_of(s.u, s.y, s.counts, recording.dt_s) for recording, s in zip(recordings, fitted, strict=True)]
    known = [(noise, samples.u.size) for noise, samples in zip(noises, fitted, strict=True) if noise is not None]
    if not known:
        return None
    power = sum(noise.rms**2 * size for noise, size in known) / sum(size for _, size in known)
    return Noise(float(np.sqrt(power)), known[0][0].seen_in)


def _model(
    recordings: Sequence[Recording],
    pairs: Sequence[tuple[Array, Array]],
    options: Options,
    selection: Selection,
    by: str,
    sources: Sequence[RecordingSource],
    notes: Sequence[str],
) -> Model:
    fit, first = selection.chosen.fit, selection.stretches[0]
    assert fit is not None
    sources = tuple(sources) or tuple(
        entry_of(r, file_sha256(Path(r.source)), None) for r in recordings if Path(r.source).is_file()
    )
    return Model(
        name=options.name,
        input=_channel(options.input, [u for u, _ in pairs]),
        output=_channel(options.output, [y for _, y in pairs]),
        hysteresis=fit.hysteresis,
        start=_start(first.fitted.path, at_rest=first.at_rest),
        provenance=Provenance(
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            by=by,
            recordings=sources,
            fit=selection.figures,
            notes="; ".join(notes),
        ),
    )


def _start(path: tuple[float, ...], *, at_rest: bool) -> Start:
    """Start state of the model: the state in which the first recording starts, if it starts from zero."""
    if at_rest and path:
        return Start(kind="reset", peak=float(f"{path[0]:.6g}"))
    return Start()


def _channel(name: str, values: Sequence[Array]) -> Channel:
    low = min(float(np.nanmin(v)) for v in values)
    high = max(float(np.nanmax(v)) for v in values)
    return Channel(channel=name, unit=unit_of(name) or name, low=low, high=high)


def _undetermined(chosen: Candidate) -> list[str]:
    """Note on plays whose columns are nearly zero: the recordings hardly move them."""
    assert chosen.fit is not None
    gram, structure = chosen.fit.gram, chosen.fit.structure
    lengths = np.sqrt(np.diag(gram)[: structure.plays])
    weak = np.flatnonzero(lengths < 1e-3 * lengths.max())
    return [f"plays above {structure.play_thresholds[k]:.3g} are hardly moved by these recordings" for k in weak[:1]]
