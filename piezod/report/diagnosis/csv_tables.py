"""CSV files of a diagnosis page."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from piezod.diagnose.findings import Findings
from piezod.report.diagnosis.residual.spectra import PowerMap


def csv_text(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format a table as CSV; floats with nine significant digits.

    Parameters
    ----------
    rows
        Cells of each row, as many as column names.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([f"{cell:.9g}" if isinstance(cell, float) else cell for cell in row] for row in rows)
    return out.getvalue()


def effects_csv(findings: Findings) -> str:
    """One row for each parameter of each effect.

    Returns
    -------
    Text of the CSV file.
    """
    header = ["effect", "scope", "confidence", "parameter", "value", "low", "high", "unit", "before", "after"]
    rows = [
        [e.name, e.scope, e.confidence, name, v.value, v.low, v.high, v.unit, e.before, e.after]
        for e in findings.effects
        for name, v in e.parameters.items()
    ]
    return csv_text(header, rows)


def places_csv(findings: Findings) -> str:
    """One row for each place in which the given model is wrong.

    Returns
    -------
    Text of the CSV file.
    """
    rows = [[place.axis, place.low, place.high, place.share, place.p] for place in findings.where]
    return csv_text(["axis", "low", "high", "share", "p"], rows)


def map_csv(before: PowerMap, after: PowerMap, start_s: float) -> str:
    """One row for each cell of the maps of both models.

    Parameters
    ----------
    before, after
        Power of the residual of the given and of the extended model.
    start_s
        Time of the first sample [s].
    """
    times_s = start_s + 0.5 * (before.time_s[:-1] + before.time_s[1:])
    middles_Hz = np.sqrt(before.frequency_Hz[:-1] * before.frequency_Hz[1:])
    frequency_Hz, time_s = np.meshgrid(middles_Hz, times_s, indexing="ij")
    levels = [power.level_dB.ravel().round(1) for power in (before, after)]
    rows = np.column_stack((time_s.ravel(), frequency_Hz.ravel(), *levels)).tolist()
    return csv_text(["time_s", "frequency_Hz", "before_dB", "after_dB"], rows)
