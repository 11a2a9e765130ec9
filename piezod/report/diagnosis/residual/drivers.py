"""The drivers of a residual: quantities that it may depend on, such as command, rate or temperature."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.localisation import coordinates
from piezod.report.diagnosis.residual.residuals import Residuals


@dataclass(frozen=True)
class Driver:
    """A quantity that a residual may depend on.

    Parameters
    ----------
    name
        Name of its CSV file and column: `voltage_V` ...
    axis
        Axis of the places that belong to it; empty for none.
    label
        Label of the axis, with unit.
    values
        Computes the quantity at each sample of a recording, shape (N,).
    directions
        Whether rising and falling commands have curves of their own.
    logarithmic
        Whether the axis is logarithmic.
    """

    name: str
    axis: str
    label: str
    values: Callable[[Residuals], Array]
    directions: bool = True
    logarithmic: bool = False


def drivers(command: str, output: str) -> list[Driver]:
    """All drivers except time."""
    since = "since the last reversal"
    return [
        Driver("voltage_V", "voltage_V", f"command [{command}]", lambda recording: recording.series.command_V),
        Driver("rate_V_per_s", "rate_V_per_s", f"rate of the command [{command}/s]", _rate, directions=False),
        Driver("force_N", "force_N", f"output of the given model [{output}]", lambda recording: recording.given),
        Driver("since_reversal_s", "", f"time {since} [s]", _time_since_reversal, logarithmic=True),
        Driver("amplitude_V", "amplitude_V", f"change of the command {since} [{command}]", _change_since_reversal),
        Driver("previous_level_V", "", f"command at the last reversal [{command}]", _command_at_reversal),
        Driver("temperature_C", "temperature_C", "temperature [°C]", _temperature, directions=False),
    ]


def time_driver(name: str, label: str) -> Driver:
    """Time of a single recording as a driver.

    Parameters
    ----------
    name
        Name of the CSV file and column of the driver.
    label
        Label of the axis, with unit.
    """
    return Driver(name, "time_s", label, lambda recording: recording.time_s, directions=False)


def since_reversal(u: Array) -> tuple[NDArray[np.int64], Array]:
    """Number of samples since the last reversal, and the command at that reversal, each shape (N,).

    Parameters
    ----------
    u
        Command, shape (N,).
    """
    direction, _ = coordinates.reversals(u)
    reversal = np.zeros(u.size, np.int64)
    for first, end, sign in _moves(direction):
        start = reversal[first - 1] if first else 0
        extreme = u[start : first + 1].argmin() if sign > 0.0 else u[start : first + 1].argmax()
        reversal[first:end] = start + int(extreme)
    return np.arange(u.size) - reversal, u[reversal]


def _moves(direction: Array) -> Iterator[tuple[int, int, float]]:
    """First sample, end and direction of each move in one direction."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(direction)) + 1, [direction.size]))
    for first, end in itertools.pairwise(edges):
        yield int(first), int(end), float(direction[first])


def _rate(recording: Residuals) -> Array:
    return coordinates.rate(recording.series.command_V, recording.series.dt_s)


def _time_since_reversal(recording: Residuals) -> Array:
    return np.maximum(since_reversal(recording.series.command_V)[0], 1) * recording.series.dt_s


def _change_since_reversal(recording: Residuals) -> Array:
    return coordinates.reversals(recording.series.command_V)[1]


def _command_at_reversal(recording: Residuals) -> Array:
    return since_reversal(recording.series.command_V)[1]


def _temperature(recording: Residuals) -> Array:
    assert recording.series.temperature_C is not None
    return recording.series.temperature_C
