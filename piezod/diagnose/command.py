"""Diagnosis of files: `piezod diagnose` writes findings and the extended model into a folder."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from piezod.diagnose.diagnosis import diagnose
from piezod.diagnose.findings import HeldOut, Verdict, above_noise
from piezod.diagnose.judgement import Diagnosis, with_words
from piezod.diagnose.verdict.simulated import free_run, tared_rms
from piezod.errors import UsageError
from piezod.estimation.recordings.intake import OnStep
from piezod.estimation.recordings.layout import layout_of
from piezod.estimation.recordings.sources import Source, past_sources, read_source
from piezod.model import Model, file_sha256, load_model, save_model
from piezod.recording import TextOptions
from piezod.recording.names import unit_of
from piezod.runtime.files import written

WORSE = 1.02  # error ratio above which a model is worse on a held-out recording; noise of a minute causes less
LOWERED: dict[Verdict, Verdict] = {"explained": "partly_explained", "matches": "unexplained"}
"""Verdict if the error of a held-out recording exceeds the noise."""
MOST_UNCERTAIN = 0.5  # highest confidence of an effect that makes a held-out recording worse: as likely wrong as right


def diagnose_files(
    recordings: Sequence[Path],
    model_path: Path,
    output: Path,
    input_column: str | None,
    output_column: str | None,
    on_step: OnStep,
    hold_out: Sequence[Path] = (),
    condition: str | None = None,
    text: TextOptions | None = None,
    within_s: float | None = None,
) -> Diagnosis:
    """Diagnose recordings and write `findings.json` and `model.yaml` into a folder.

    Parameters
    ----------
    model_path
        Model; its identification recordings are used too if they still exist.
    output
        Folder; created if missing.
    input_column, output_column
        Columns; None: the columns of the model.
    on_step
        Called with the current step, and the share of the work done if known.
    hold_out
        Recordings for a comparison of both models, not used for fits.
    condition
        COLUMN=VALUE at which the readings of `recordings` count; the simulation runs over all samples.
    text
        Options for text files; None: determined from the files.
    within_s
        Time for the diagnosis [s]; None: no limit.

    Raises
    ------
    RecordingError, ConfigurationError
        A file cannot be used.
    UsageError
        A recording is given twice.
    """
    model = _with_columns(load_model(model_path), input_column, output_column)
    files = [*recordings, *hold_out]
    if len({path.resolve() for path in files}) < len(files):
        raise UsageError(f"REC is {', '.join(map(str, files))}: one stands twice, must be different files")
    columns = (model.input.channel, model.output.channel)
    held_out = [read_source(path, "recording", columns, text=layout_of(path, model, text)) for path in hold_out]
    diagnosed = [
        read_source(path, "recording", columns, condition, layout_of(path, model, text)) for path in recordings
    ]
    past, past_notes = past_sources(model, model_path.parent, diagnosed)
    notes = [*(note for source in (*diagnosed, *held_out) for note in source.notes), *past_notes]
    before = [_rms(source, model) for source in held_out]  # an unusable file raises before the long search
    diagnosis = diagnose(model, diagnosed, past, notes, on_step, within_s, file_sha256(model_path))
    if held_out:
        on_step("simulating what was held out", None)
        diagnosis = _checked(diagnosis, model, held_out, before)
    written(output / "findings.json", json.dumps(diagnosis.findings.as_dict(), indent=2) + "\n", parents=True)
    save_model(diagnosis.model, output / "model.yaml")
    return diagnosis


def _checked(diagnosis: Diagnosis, given: Model, held_out: Sequence[Source], before: Sequence[float]) -> Diagnosis:
    """Diagnosis checked on held-out recordings; `before`: their errors with the given model."""
    errors = _compared(held_out, before, diagnosis.model)
    if diagnosis.without_law is not None:
        errors_without_law = _compared(held_out, before, diagnosis.without_law.model)
        diagnosis, errors = with_checked_law(diagnosis, errors, errors_without_law)
    return with_held_out(diagnosis, given, errors)


def with_held_out(diagnosis: Diagnosis, given: Model, held_out: Sequence[HeldOut]) -> Diagnosis:
    """Diagnosis with the errors of held-out recordings, to which its verdict then applies too.

    If a recording gets worse, the given model stays and no confidence exceeds `MOST_UNCERTAIN`. If an error exceeds the
    noise, nothing is explained and nothing matches.
    """
    findings = replace(diagnosis.findings, held_out=tuple(held_out))
    model, unit, notes = diagnosis.model, findings.unit, list(findings.notes)
    worse = [recording for recording in held_out if recording.after > WORSE * recording.before]
    if worse and model is not given:
        effects = tuple(replace(f, confidence=min(f.confidence, MOST_UNCERTAIN)) for f in findings.effects)
        base = replace(findings.base, confidence=min(findings.base.confidence, MOST_UNCERTAIN))
        findings = replace(findings, effects=effects, base=base, law=None, after=findings.before)
        model = given
        notes += [
            f"{recording.path}, held out: the extended model is worse, {recording.before:.3g} -> {recording.after:.3g} "
            f"{unit}; the given model stays"
            for recording in worse
        ]
    errors = {recording.path: recording.before if model is given else recording.after for recording in held_out}
    large = {path: error for path, error in errors.items() if above_noise(error, findings.floor, findings.span)}
    notes += [f"{path}, held out: {error:.3g} {unit} is left, more than the noise" for path, error in large.items()]
    verdict = LOWERED.get(findings.verdict, findings.verdict) if worse or large else findings.verdict
    findings = with_words(replace(findings, verdict=verdict, notes=tuple(notes)), given)
    words = findings.words
    words += "; a recording that was held out gets worse" if worse else ""
    words += "; more than noise is left of a recording that was held out" if large and not worse else ""
    return replace(diagnosis, findings=replace(findings, words=words), model=model)


def with_checked_law(
    diagnosis: Diagnosis, with_law: tuple[HeldOut, ...], without_law: tuple[HeldOut, ...]
) -> tuple[Diagnosis, tuple[HeldOut, ...]]:
    """Diagnosis without its unnamed law if the law makes a held-out recording worse, and the errors of its model."""
    plain = diagnosis.without_law
    if plain is None or all(law.after <= other.after for law, other in zip(with_law, without_law, strict=True)):
        return diagnosis, with_law
    note = "an unnamed law fits the recordings, but makes one that was held out worse, and is left out"
    return replace(plain, findings=replace(plain.findings, notes=(*plain.findings.notes, note))), without_law


def _compared(sources: Sequence[Source], before: Sequence[float], extended: Model) -> tuple[HeldOut, ...]:
    """Held-out recordings with the errors of the given model (`before`) and of the extended model."""
    return tuple(
        HeldOut(source.recording.source, source.sha256, error, _rms(source, extended))
        for source, error in zip(sources, before, strict=True)
    )


def _rms(source: Source, model: Model) -> float:
    return tared_rms([free_run(model, source)])


def _with_columns(model: Model, input_column: str | None, output_column: str | None) -> Model:
    """Model for the named columns; negated readings stay negated."""
    changes = {}
    for side, column in (("input", input_column), ("output", output_column)):
        if column is not None:
            channel = getattr(model, side)
            sign = "-" if channel.channel.startswith("-") else ""
            named = f"{sign}{column.removeprefix('-')}"
            changes[side] = channel.model_copy(update={"channel": named, "unit": unit_of(column) or column})
    return model.model_copy(update=changes)
