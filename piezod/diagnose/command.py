"""`piezod diagnose`: files in, a folder with findings and the extended model out."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from piezod.diagnose.diagnosis import Diagnosis, diagnose
from piezod.diagnose.prepare import past_sources, read_source
from piezod.errors import ConfigurationError, UsageError
from piezod.model import Model, load_model, save_model

OnStep = Callable[[str, float | None], None]


def diagnose_files(
    recordings: Sequence[Path],
    model_path: Path,
    output: Path,
    input_column: str | None,
    output_column: str | None,
    on_step: OnStep,
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

    Raises
    ------
    RecordingError, ConfigurationError
        A file cannot be used.
    UsageError
        A recording is given twice.
    """
    model = _with_columns(load_model(model_path), input_column, output_column)
    if len({path.resolve() for path in recordings}) < len(recordings):
        raise UsageError(f"REC is {', '.join(map(str, recordings))}: one stands twice, must be different files")
    asked = [read_source(path, "recording") for path in recordings]
    past, notes = past_sources(model, model_path.parent, asked)
    diagnosis = diagnose(model, asked, past, notes, lambda what: on_step(what, None))
    try:
        output.mkdir(parents=True, exist_ok=True)
        text = json.dumps(diagnosis.findings.as_dict(), indent=2) + "\n"
        (output / "findings.json").write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written: {error.strerror}") from error
    save_model(diagnosis.model, output / "model.yaml")
    return diagnosis


def _with_columns(model: Model, input_column: str | None, output_column: str | None) -> Model:
    """The model for other columns, where they were named."""
    changes = {}
    for side, column in (("input", input_column), ("output", output_column)):
        if column is not None:
            channel = getattr(model, side)
            changes[side] = channel.model_copy(update={"channel": column, "unit": column.rpartition("_")[2] or column})
    return model.model_copy(update=changes)
