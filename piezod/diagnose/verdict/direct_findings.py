"""Findings that the readings show without a fit: frozen stretches and a coarse converter."""

from collections.abc import Mapping, Sequence

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.findings import Finding, Place, Value
from piezod.diagnose.verdict.evidence import finding_about
from piezod.effects import quantisation, sensor_dropout
from piezod.estimation.recordings.series import Series

Stretches = Mapping[int, list[tuple[int, int]]]

FROZEN_NOISES = 2.0  # least rms residual of a frozen stretch [noise rms]; a correct model leaves 1
COARSE_STEP = 0.5  # step / sqrt(12) over the other noise, above which the converter is reported
FROZEN_CONFIDENCE, COARSE_CONFIDENCE = 0.97, 0.95


def direct_findings(
    series: Sequence[Series], frozen: Stretches, residuals: Sequence[Array], before: float
) -> list[Finding]:
    """Frozen readings and coarse converters of the diagnosed recordings.

    `frozen`: first sample and end of each stretch, by number of the series; `before`: error of the given model.
    """
    findings = []
    places = tuple(
        Place("time_s", series[k].start_s + a * series[k].dt_s, series[k].start_s + b * series[k].dt_s)
        for k, stretches in confirmed_frozen(series, frozen, residuals).items()
        for a, b in stretches
        if series[k].role == "recording"
    )
    if places:
        ends = {"from_s": places[0].low, "to_s": places[0].high}
        values = {name: Value(value, "s", value, value) for name, value in ends.items()}
        errors = before, before
        findings.append(finding_about(sensor_dropout.EFFECT, FROZEN_CONFIDENCE, "once", places, values, errors))
    step, noise = _coarsest(series, residuals)
    if step > 0.0 and step / np.sqrt(12.0) > COARSE_STEP * noise:
        values = {"step_N": Value(step, "N", 0.99 * step, 1.01 * step)}
        findings.append(finding_about(quantisation.EFFECT, COARSE_CONFIDENCE, "since", (), values, (before, before)))
    return findings


def confirmed_frozen(
    series: Sequence[Series], frozen: Stretches, residuals: Sequence[Array]
) -> dict[int, list[tuple[int, int]]]:
    """Frozen stretches that the residual of the final hypothesis confirms, by the number of the series.

    A delay that the given model lacks makes a reading seem frozen at each edge of the command.
    """
    return {
        k: [stretch for stretch in stretches if _is_frozen(series[k], residuals[k], slice(*stretch))]
        for k, stretches in frozen.items()
    }


def _is_frozen(series: Series, residual: Array, stretch: slice) -> bool:
    """Whether the readings of a stretch are equal, or differ from the hypothesis by more than noise."""
    equal = np.ptp(series.reading_N[stretch]) == 0.0
    noise_N = max(series.noise_N, series.lattice_N)
    return bool(equal or np.sqrt(np.mean(residual[stretch] ** 2)) > FROZEN_NOISES * noise_N)


def _coarsest(series: Sequence[Series], residuals: Sequence[Array]) -> tuple[float, float]:
    """Largest converter step among the diagnosed recordings, and the other noise of that recording [N]."""
    step, k = max((recording.lattice_N, k) for k, recording in enumerate(series) if recording.role == "recording")
    spread = float(np.std(residuals[k][series[k].counts]))
    return step, float(np.sqrt(max(spread**2 - step**2 / 12.0, 0.0)))
