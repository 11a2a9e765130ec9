"""`Model`: the model of a bench with its file and its inverse at hand."""

import os
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod import model as room
from piezod.errors import UsageError

Array = NDArray[np.float64]


class Model(room.Model):
    """Content of a model file.

    Its fields are those of the file: `input`, `output`, `hysteresis`, `effects`, `provenance` and others.
    """

    @classmethod
    def of(cls, model: room.Model) -> Self:
        """Convert a model of the room `model`."""
        return cls.model_construct(
            model.model_fields_set, **{name: getattr(model, name) for name in type(model).model_fields}
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model file.

        Raises
        ------
        ConfigurationError
            A value is wrong; the message names file, line, key, value and limit.
        ModelError
            The schema differs, or the model has no inverse.
        """
        return cls.of(room.load_model(Path(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a model file.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        """
        room.save_model(self, Path(path))

    def inverse(self, rate_Hz: float = 1000.0) -> "Inverse":
        """The compensator that the daemon runs, for use without a bench; parameters and errors as for `Inverse`."""
        return Inverse(self, rate_Hz)


class Inverse:
    """Inverse of a model, as the daemon runs it.

    Parameters
    ----------
    rate_Hz
        Ticks per second, above 0 [Hz].

    Raises
    ------
    ModelError
        The model or an effect has no inverse.
    UsageError
        The rate is not above 0.
    """

    def __init__(self, model: room.Model, rate_Hz: float) -> None:
        if not 0.0 < rate_Hz < np.inf:
            raise UsageError(f"rate_Hz is {rate_Hz:g}, must be above 0")
        self._compensator = room.make_compensator("inverse", model, 1.0 / rate_Hz)
        self._low_V, self._high_V = model.input.low, model.input.high

    def reset(self) -> None:
        """Return to the start state of the model."""
        self._compensator.reset()

    def plan(self, reference: float) -> float:
        """Voltage for a force [input unit]; no state moves."""
        return self._compensator.plan(reference)

    def commit(self, voltage_V: float) -> None:
        """Update every state with the applied voltage [input unit]."""
        self._compensator.commit(voltage_V)

    def voltages(self, reference: ArrayLike) -> Array:
        """Voltages for references, both shape (N,); each is limited to the identified range and committed."""
        wanted = np.asarray(reference, dtype=np.float64)
        applied = np.empty(wanted.size)
        for tick, force in enumerate(wanted):
            applied[tick] = min(max(self.plan(float(force)), self._low_V), self._high_V)
            self.commit(applied[tick])
        return applied
