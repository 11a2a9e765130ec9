"""`piezod diagnose`: files in, a folder with findings and the extended model out."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from piezod.diagnose.diagnosis import diagnose
from piezod.diagnose.findings import HeldOut, Verdict, above_noise
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.prepare import Source, past_sources, read_source
from piezod.diagnose.verdict.simulated import free_run, tared_rms
from piezod.diagnose.verdict.verdict import words_of
from piezod.diagnose.verdict.words import Wording
from piezod.errors import ConfigurationError, UsageError
from piezod.identify.layout import layout_of
from piezod.model import Model, load_model, save_model
from piezod.recording import TextOptions
from piezod.recording.names import unit_of

WORSE = 1.02  # times the error of the given model on a recording held out: the noise of a minute does not do that
LESS: dict[Verdict, Verdict] = {"explained": "partly_explained", "matches": "unexplained"}
"""Verdicts that do not hold where more than noise is left of a recording that was held out."""

MOST_DOUBTED = 0.5  # confidence of an effect that makes such a recording worse
OnStep = Callable[[str, float | None], None]


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
) -> Diagnosis:
    """Diagnose recordings and write `findings.json` and `model.yaml` into a folder.

    Parameters
    ----------
    recordings
        To be explained.
    model_path
        The model; the recordings that it was identified on are used too where they are still there.
    output
        Folder, made where it is not there.
    input_column, output_column
        Columns; None: the model's.
    on_step
        Told what is being done.
    hold_out
        Recordings that both models are compared on and nothing is fitted to.
    condition
        COLUMN=VALUE at which the readings of `recordings` count; the memory runs through all samples.
    text
        What the user says about text files; None: everything is found from the files.

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
    apart = [read_source(path, "recording", columns, text=layout_of(path, model, text)) for path in hold_out]
    asked = [read_source(path, "recording", columns, condition, layout_of(path, model, text)) for path in recordings]
    past, notes = past_sources(model, model_path.parent, asked)
    notes = [*(note for one in (*asked, *apart) for note in one.notes), *notes]
    before = [_rms(one, model) for one in apart]  # before the search: a file that cannot be used is said at once
    diagnosis = diagnose(model, asked, past, notes, on_step)
    if apart:
        on_step("simulating what was held out", 0.98)
        told = _compared(apart, before, diagnosis.model)
        if diagnosis.without_law is not None:
            plain = _compared(apart, before, diagnosis.without_law.model)
            diagnosis, told = law_checked(diagnosis, told, plain)
        diagnosis = checked_by(diagnosis, model, told)
    try:
        output.mkdir(parents=True, exist_ok=True)
        content = json.dumps(diagnosis.findings.as_dict(), indent=2) + "\n"
        (output / "findings.json").write_text(content, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written: {error.strerror}") from error
    save_model(diagnosis.model, output / "model.yaml")
    return diagnosis


def checked_by(diagnosis: Diagnosis, given: Model, held_out: Sequence[HeldOut]) -> Diagnosis:
    """The diagnosis with the recordings that were held out: its verdict holds for them too.

    Where one gets worse, the given model stays, no improvement is claimed, and no effect is more likely than not. Where
    more than noise is left of one, nothing is explained and nothing matches.

    Parameters
    ----------
    diagnosis
        Of other recordings.
    given
        The given model.
    held_out
        Errors of both models.
    """
    findings = replace(diagnosis.findings, held_out=tuple(held_out))
    model, unit, notes = diagnosis.model, findings.unit, list(findings.notes)
    worse = [one for one in held_out if one.after > WORSE * one.before]
    if worse and model is not given:
        effects = tuple(replace(one, confidence=min(one.confidence, MOST_DOUBTED)) for one in findings.effects)
        base = replace(findings.base, confidence=min(findings.base.confidence, MOST_DOUBTED))
        findings = replace(findings, effects=effects, base=base, law=None, after=findings.before)
        model = given
        notes += [
            f"{one.path}, held out: the extended model is worse, {one.before:.3g} -> {one.after:.3g} {unit}; "
            "the given model stays"
            for one in worse
        ]
    errors = {one.path: one.before if model is given else one.after for one in held_out}
    left = {path: error for path, error in errors.items() if above_noise(error, findings.floor, findings.span)}
    notes += [f"{path}, held out: {error:.3g} {unit} is left, more than the noise" for path, error in left.items()]
    verdict = findings.verdict
    if (worse or left) and verdict in LESS:
        verdict = LESS[verdict]
    findings = replace(findings, verdict=verdict, notes=tuple(notes))
    words = words_of(findings, Wording(given.input.unit, given.output.unit))
    words += "; a recording that was held out gets worse" if worse else ""
    words += "; more than noise is left of a recording that was held out" if left and not worse else ""
    return replace(diagnosis, findings=replace(findings, words=words), model=model)


def law_checked(
    diagnosis: Diagnosis, with_it: tuple[HeldOut, ...], without: tuple[HeldOut, ...]
) -> tuple[Diagnosis, tuple[HeldOut, ...]]:
    """The diagnosis and the errors of its model; without its unnamed law where that makes a recording worse.

    Parameters
    ----------
    diagnosis
        With an unnamed law.
    with_it, without
        Errors of the extended model with and without the law, on recordings that were held out.
    """
    plain = diagnosis.without_law
    if plain is None or all(law.after <= other.after for law, other in zip(with_it, without, strict=True)):
        return diagnosis, with_it
    note = "an unnamed law fits the recordings, but makes one that was held out worse, and is left out"
    return replace(plain, findings=replace(plain.findings, notes=(*plain.findings.notes, note))), without


def _compared(apart: Sequence[Source], before: Sequence[float], extended: Model) -> tuple[HeldOut, ...]:
    """Recordings that were held out, with the errors of the given model and of another one."""
    return tuple(
        HeldOut(one.recording.source, one.sha256, given, _rms(one, extended))
        for one, given in zip(apart, before, strict=True)
    )


def _rms(source: Source, model: Model) -> float:
    return tared_rms([free_run(model, source)])


def _with_columns(model: Model, input_column: str | None, output_column: str | None) -> Model:
    """The model for other columns, where they were named; a model of negated readings stays one."""
    changes = {}
    for side, column in (("input", input_column), ("output", output_column)):
        if column is not None:
            channel = getattr(model, side)
            sign = "-" if channel.channel.startswith("-") else ""
            named = f"{sign}{column.removeprefix('-')}"
            changes[side] = channel.model_copy(update={"channel": named, "unit": unit_of(column) or column})
    return model.model_copy(update=changes)
