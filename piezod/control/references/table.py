"""References that are known ahead: a table of values, and the table of a waveform."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.config.reference import WaveformReference
from piezod.control.references.reference import Freshness
from piezod.control.references.repeat_correction import RepeatCorrection
from piezod.errors import ConfigurationError
from piezod.excitation import shape, whole_periods

MOST_TICKS = 50_000_000  # 400 MB of values


class TableReference:
    """Values known ahead, one a tick. A skipped tick skips its value.

    Parameters
    ----------
    values
        Force [N] or voltage [V], shape (N,), finite.
    loop
        Whether the values begin again at the end.
    ramp_down_on_lapse
        What follows the end. True: a ramp down. False: the last value is held.

    Raises
    ------
    ConfigurationError
        There are no values, or some are not finite.
    """

    def __init__(self, values: ArrayLike, *, loop: bool = False, ramp_down_on_lapse: bool = True) -> None:
        table = np.asarray(values, dtype=float)
        if table.ndim != 1 or table.size == 0 or not np.isfinite(table).all():
            raise ConfigurationError("reference: needs at least one value, all finite")
        self._values = _packed(table)
        self._ahead = self._values
        self._run_in = self._ahead[:0]
        self._loop = loop
        self._correction: RepeatCorrection | None = None
        self._first = 0
        self.ahead = self._values[0]
        self.ramp_down_on_lapse = ramp_down_on_lapse
        self.freshness = Freshness.LIVE

    def __len__(self) -> int:
        """Number of ticks of one pass."""
        return len(self._values)

    def plan_ahead(self, shaped: Callable[..., NDArray[np.float64]], ticks: int) -> None:
        """Set the values of `ahead` to `shaped(values, loop=...)`.

        The first value is repeated for `ticks` ticks, in which the shaped values run in. At the end of a table without
        loop the last value is repeated likewise, until the readings have arrived there.

        Parameters
        ----------
        shaped
            Function that leads values by delay and resonance: shape (N,) to shape (N,).
        ticks
            Length of the lead [ticks].
        """
        values = np.asarray(self._values)
        begun = shaped(np.pad(values, (ticks, 0), mode="edge"), loop=False)
        self._run_in = _packed(begun[:ticks])
        if not self._loop:
            values = np.pad(values, (0, ticks), mode="edge")
            self._values = _packed(values)
        ahead = shaped(values, loop=self._loop)
        assert ahead.shape == values.shape
        self._ahead = _packed(ahead)

    def correct_by(self, correction: RepeatCorrection) -> None:
        """Add a learned correction to `ahead`, from the next start on.

        Parameters
        ----------
        correction
            Correction of every tick of a pass.

        Raises
        ------
        ConfigurationError
            The table is not looped, or has another number of ticks.
        """
        if not self._loop or correction.ticks != len(self._values):
            raise ConfigurationError(
                f"learning: a correction of {correction.ticks} ticks for a table of {len(self._values)} ticks, must be "
                "equal, and the table looped; was the reference file exchanged? start again"
            )
        self._correction = correction

    def planned(self) -> NDArray[np.float64]:
        """Values of `ahead` of a pass without a correction, shape (N,)."""
        return np.array(self._ahead)

    def values(self) -> NDArray[np.float64]:
        """Values of a pass, shape (N,)."""
        return np.array(self._values)

    @property
    def loops(self) -> bool:
        """Whether the values begin again at the end."""
        return self._loop

    def span(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return min(self._values), max(self._values)

    def begin(self) -> None:
        """No effect: a table is known ahead."""

    def idle(self, now_ns: int) -> None:
        """No effect: a table is known ahead."""

    def start(self, tick: int) -> None:
        """Let the first sample belong to `tick`."""
        self._first = tick
        self.freshness = Freshness.LIVE
        if self._correction is not None:
            self._correction.start(tick + len(self._run_in))

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Value of `tick`."""
        k = tick - self._first - len(self._run_in)
        correction = self._correction
        if k < 0:
            self.ahead = self._run_in[k] + (0.0 if correction is None else correction.read(0, 0))
            return self._values[0]
        repeat = 0
        if k >= len(self._values):
            if not self._loop:
                self.freshness = Freshness.ENDED
                k = len(self._values) - 1
            repeat = k // len(self._values)
            k %= len(self._values)
        self.ahead = self._ahead[k]
        if correction is not None:
            self.ahead += correction.read(repeat, k)
        return self._values[k]

    def close(self) -> None:
        """No effect: a table opens nothing."""


def _packed(values: NDArray[np.float64]) -> "memoryview[float]":
    """Values as a memory view, which gives plain floats without a NumPy scalar in every tick."""
    return memoryview(np.ascontiguousarray(values).tobytes()).cast("d")


def waveform_table(config: WaveformReference, rate_Hz: float) -> TableReference:
    """Table of a built-in waveform. Without a duration, it holds whole periods and is looped.

    Parameters
    ----------
    config
        Section `reference` of the bench configuration.
    rate_Hz
        Tick rate [Hz].

    Raises
    ------
    ConfigurationError
        The waveform is too fast for the tick rate, or has too many ticks.
    """
    if config.frequency_Hz > rate_Hz / 4:
        raise ConfigurationError(
            f"reference.frequency_Hz is {config.frequency_Hz:g}, must be at most a quarter of rate_Hz, {rate_Hz / 4:g}"
        )
    periods, ticks = whole_periods(config.frequency_Hz, rate_Hz)
    if config.duration_s is not None:
        ticks = max(1, round(config.duration_s * rate_Hz))
        periods = config.frequency_Hz * ticks / rate_Hz
    if ticks > MOST_TICKS:
        raise ConfigurationError(f"reference: has {ticks} ticks, must have at most {MOST_TICKS}; shorten duration_s")
    phase = np.arange(ticks, dtype=np.float64) * (periods / ticks)
    unit = shape(config.kind, phase, levels=config.levels, seed=config.seed)
    values = config.offset_N + config.amplitude_N * unit
    return TableReference(values, loop=config.duration_s is None, ramp_down_on_lapse=config.at_end == "ramp_down")
