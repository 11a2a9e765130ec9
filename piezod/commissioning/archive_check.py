"""Check of the model in use with the newest recorded drive: `piezod diagnose --from-archive`, started once a day."""

import os
from pathlib import Path

from piezod.config import load_bench, model_path
from piezod.config.sections import DriftConfig
from piezod.errors import TemporaryError
from piezod.model import load_model
from piezod.recorder.newest_stretch import newest_stretch
from piezod.recording import write_csv

STRETCH = "stretch.csv"
LONG_ENOUGH_S = 60.0  # end of a drive that is diagnosed, where `drift.keep_s` is less


def prepare_check(path: Path, output: Path) -> tuple[Path, Path, Path]:
    """Write the newest stretch of a bench into a folder of its own.

    Parameters
    ----------
    output
        Folder of all checks of the bench.

    Returns
    -------
    tuple
        Recording, model in use, and folder of this check.

    Raises
    ------
    ConfigurationError
        The bench has no recorder, no model, or a folder cannot be used.
    TemporaryError
        Nothing was driven since the last check.
    """
    bench = load_bench(path)
    _leave_cpu(bench.real_time.cpu)
    model_file = model_path(bench, path)
    model = load_model(model_file)
    longest_s = max((bench.drift or DriftConfig()).keep_s, LONG_ENOUGH_S)
    stretch = newest_stretch(bench, model.input.high - model.input.low, longest_s)
    recorded = stretch.metadata["recorded"]
    folder = output / f"{bench.name}-{recorded[:19].replace(':', '').replace('-', '')}"
    if (folder / "findings.json").exists():
        raise TemporaryError(f"{folder}: this drive is checked already, and none is newer")
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(stretch, folder / STRETCH)
    return folder / STRETCH, model_file, folder


def _leave_cpu(tick_cpu: int | None) -> None:
    """Keep this process from the processor core of the ticks, `real_time.cpu`, if there is another one."""
    others = os.sched_getaffinity(0) - {tick_cpu}
    if others:
        os.sched_setaffinity(0, others)
