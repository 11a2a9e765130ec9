"""Checks of arguments. A wrong argument raises an error of one sentence with name, value and limit."""

import math
import operator
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.errors import UsageError


def path_of(value: object, name: str = "path") -> Path:
    """Path as text or as an object of `pathlib`.

    Raises
    ------
    UsageError
        The value is no path, or an empty one.
    """
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text:
        raise UsageError(f"{name} is {_shown(value)}, must be the path of a file")
    return Path(text)


def text_of(value: str | None, name: str) -> str | None:
    """Text, or None.

    Raises
    ------
    UsageError
        The value is another object, or empty.
    """
    if value is not None and (not isinstance(value, str) or not value):
        raise UsageError(f"{name} is {_shown(value)}, must be text")
    return value


def texts_of(value: str | Sequence[str], name: str) -> list[str]:
    """One text or several as a list.

    Raises
    ------
    UsageError
        The value is another object.
    """
    some = [value] if isinstance(value, str) else value
    if not isinstance(some, list | tuple) or not all(isinstance(text, str) for text in some):
        raise UsageError(f"{name} is {_shown(value)}, must be a text or a list of texts")
    return list(some)


def number_of(value: float, name: str, *, above: float = -math.inf, least: float = -math.inf) -> float:
    """Finite number.

    Parameters
    ----------
    above, least
        Limits: the number must be larger than the first and not smaller than the second.

    Raises
    ------
    UsageError
        The value is no finite number, or outside the limits.
    """
    limit = f" above {above:g}" if above > -math.inf else f" of at least {least:g}" if least > -math.inf else ""
    try:
        number = float(value) if not isinstance(value, str | bytes) else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or number <= above or number < least:
        raise UsageError(f"{name} is {_shown(value)}, must be a finite number{limit}")
    return number


def count_of(value: int | None, name: str, least: int, most: int) -> int | None:
    """Whole number from `least` to `most`, or None.

    Raises
    ------
    UsageError
        The value is no whole number, or outside the limits.
    """
    if value is None:
        return None
    try:
        number = operator.index(value) if not isinstance(value, bool) else least - 1
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise UsageError(f"{name} is {_shown(value)}, must be a whole number from {least} to {most}")
    return number


def samples_of(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Finite numbers in one row, shape (N,).

    Raises
    ------
    UsageError
        The values are no numbers, have another shape, or one of them is not finite.
    """
    try:
        samples = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{name} is {_shown(values)}, must be one row of numbers") from None
    if samples.ndim != 1:
        raise UsageError(f"{name} has the shape {samples.shape}, must be one row of numbers")
    if not np.isfinite(samples).all():
        first = int(np.argmin(np.isfinite(samples)))
        raise UsageError(f"{name} is {samples[first]} at sample {first}, must be finite")
    return samples


def check_callable(value: Callable[..., object], name: str) -> None:
    """Refuse an object that cannot be called.

    Raises
    ------
    UsageError
        The value cannot be called.
    """
    if not callable(value):
        raise UsageError(f"{name} is {_shown(value)}, must be a function of a text and a number")


def _shown(value: object) -> str:
    """A short value as it is written, else its kind."""
    written = repr(value)
    return written if len(written) <= 40 else f"of the kind {type(value).__name__}"
