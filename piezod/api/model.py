"""`Model`: the model of a bench with its file and its inverse at hand."""

import os
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from piezod import model as room
from piezod.api.arguments import number_of, path_of, samples_of
from piezod.arrays import Array
from piezod.errors import UsageError


class HasModel(Protocol):
    """A result that holds a model, of `piezod.identify` or `piezod.diagnose`."""

    @property
    def model(self) -> room.Model:
        """The model."""


class Model(room.Model):
    """Content of a model file.

    Its fields are those of the file: `input`, `output`, `hysteresis`, `effects`, `provenance` and others.
    """

    @classmethod
    def of(cls, model: room.Model | HasModel) -> Self:
        """The model of a result, or a model of the room `model`.

        Returns
        -------
        Model
            A model with equal content.

        Raises
        ------
        UsageError
            The argument is neither a model nor a result.

        Examples
        --------
        >>> piezod.Model.of(found).output.channel
        'force_N'
        """
        inside = model if isinstance(model, room.Model) else getattr(model, "model", None)
        if not isinstance(inside, room.Model):
            raise UsageError(
                f"model is of the kind {type(model).__name__}, must be a Model, a result of identify or diagnose, or "
                "the path of a model file"
            )
        return cls.model_construct(
            inside.model_fields_set, **{name: getattr(inside, name) for name in type(inside).model_fields}
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model file.

        Returns
        -------
        Model
            The model in the file.

        Raises
        ------
        ConfigurationError
            A value is wrong; the message names file, line, key, value and limit.
        ModelError
            The schema differs, or the model has no inverse.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> model = piezod.Model.load("model.yaml")
        >>> model.input.channel
        'voltage_V'
        """
        return cls.of(room.load_model(path_of(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a model file.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> model.save("copy.yaml")
        >>> piezod.Model.load("copy.yaml") == model
        True
        """
        room.save_model(self, path_of(path))

    def inverse(self, rate_Hz: float = 1000.0) -> "Inverse":
        """The compensator that the daemon runs, for use without a bench.

        Returns
        -------
        Inverse
            The compensator in the start state of the model.

        Raises
        ------
        ModelError, UsageError
            As for `Inverse`.

        Examples
        --------
        >>> inverse = model.inverse(rate_Hz=200.0)
        >>> inverse.voltages([0.0, 50.0, 100.0]).shape
        (3,)
        """
        return Inverse(self, rate_Hz)


GivenModel = Model | HasModel | str | os.PathLike[str]
"""A model, a result that holds one, or the path of a model file."""


def model_of(given: GivenModel) -> Model:
    """The model that a caller gives; errors as for `Model.of` and `Model.load`."""
    if isinstance(given, Model):
        return given
    return Model.load(given) if isinstance(given, str | os.PathLike) else Model.of(given)


class Inverse:
    """Inverse of a model, as the daemon runs it.

    Parameters
    ----------
    model
        A model, or a result that holds one.
    rate_Hz
        Ticks per second, above 0 [Hz].

    Raises
    ------
    ModelError
        The model or an effect has no inverse.
    UsageError
        The rate is not above 0, or the model is none.
    """

    def __init__(self, model: room.Model | HasModel, rate_Hz: float) -> None:
        dt_s = 1.0 / number_of(rate_Hz, "rate_Hz", above=0.0)
        plant = Model.of(model)
        self._compensator = room.make_compensator("inverse", plant, dt_s)
        self._low_V, self._high_V = plant.input.low, plant.input.high

    def reset(self) -> None:
        """Return to the start state of the model.

        Examples
        --------
        >>> inverse = model.inverse()
        >>> first = inverse.voltages([10.0, 50.0])
        >>> inverse.reset()
        >>> bool((inverse.voltages([10.0, 50.0]) == first).all())
        True
        """
        self._compensator.reset()

    def plan(self, reference: float) -> float:
        """Voltage for a force; no state moves.

        Parameters
        ----------
        reference
            Force [output unit of the model].

        Returns
        -------
        float
            Voltage, which may lie outside the identified range [input unit].

        Raises
        ------
        UsageError
            The force is no finite number.

        Examples
        --------
        >>> inverse = model.inverse()
        >>> voltage_V = inverse.plan(50.0)
        >>> inverse.commit(voltage_V)
        """
        return self._compensator.plan(number_of(reference, "reference"))

    def commit(self, voltage_V: float) -> None:
        """Update every state with the applied voltage.

        Parameters
        ----------
        voltage_V
            Voltage as the bench received it [input unit].

        Raises
        ------
        UsageError
            The voltage is no finite number.

        Examples
        --------
        >>> inverse = model.inverse()
        >>> inverse.commit(20.0)
        """
        self._compensator.commit(number_of(voltage_V, "voltage_V"))

    def voltages(self, reference: ArrayLike) -> Array:
        """Voltages for forces, one after the other; each is committed.

        Parameters
        ----------
        reference
            Forces, shape (N,) [output unit of the model].

        Returns
        -------
        ndarray
            Voltages within the identified range, shape (N,) [input unit].

        Raises
        ------
        UsageError
            The forces are not one row of finite numbers.

        Examples
        --------
        >>> voltage_V = model.inverse().voltages([0.0, 50.0, 100.0])
        >>> bool(voltage_V[1] < voltage_V[2])
        True
        """
        wanted = samples_of(reference, "reference")
        applied = np.empty(wanted.size)
        for tick, force in enumerate(wanted.tolist()):
            applied[tick] = min(max(self._compensator.plan(force), self._low_V), self._high_V)
            self._compensator.commit(float(applied[tick]))
        return applied
