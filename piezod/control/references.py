"""Where the force to be followed comes from: tables known ahead, a register, or a stream of datagrams."""

import socket
import struct
from collections.abc import Callable
from enum import IntEnum
from math import isfinite
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezod.config.reference import (
    FileReference,
    ReferenceConfig,
    RegisterReference,
    StreamReference,
    WaveformReference,
)
from piezod.errors import BusyError, ConfigurationError, RecordingError
from piezod.excitation import shape, whole_periods
from piezod.recording import read_csv
from piezod.transport import Reading

MOST_TICKS = 50_000_000  # 400 MB of values


class Freshness(IntEnum):
    """Whether a reference can be followed."""

    LIVE = 0
    STALE = 1
    ENDED = 2


class Reference(Protocol):
    """What the tick asks of every reference."""

    freshness: Freshness
    ramp_down_on_lapse: bool
    ahead: float
    """What to plan for, so that the readings follow the value read last; the value itself where no more is known."""

    def start(self, tick: int) -> None:
        """The first sample belongs to `tick`."""
        ...

    def read(self, tick: int, now_ns: int) -> float:
        """Newest value [N]; sets `freshness`."""
        ...

    def close(self) -> None:
        """Let go of what was opened."""
        ...


class TableReference:
    """Values known ahead, one a tick; a skipped tick skips its value.

    Parameters
    ----------
    values
        Shape (N,), in the unit of what is driven.
    loop
        Start again at the end.
    ramp_down_on_lapse
        What follows the end: a ramp down, or holding the last value.

    Raises
    ------
    ConfigurationError
        No values, or values that are not finite.
    """

    def __init__(self, values: ArrayLike, *, loop: bool = False, ramp_down_on_lapse: bool = True) -> None:
        table = np.asarray(values, dtype=float)
        if table.ndim != 1 or table.size == 0 or not np.isfinite(table).all():
            raise ConfigurationError("reference: needs at least one value, all finite")
        self._values = _packed(table)
        self._ahead = self._values
        self._run_in = self._ahead[:0]
        self._loop = loop
        self._first = 0
        self.ahead = self._values[0]
        self.ramp_down_on_lapse = ramp_down_on_lapse
        self.freshness = Freshness.LIVE

    def __len__(self) -> int:
        """Ticks of one pass."""
        return len(self._values)

    def plan_ahead(self, shaped: Callable[..., NDArray[np.float64]], ticks: int) -> None:
        """Plan for `shaped(values, loop=...)` in place of the values, which a delay or a mode would bring late.

        The first value is held for `ticks` more, in which the plan runs in; the last one too, until it has arrived.
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

    def span(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return min(self._values), max(self._values)

    def start(self, tick: int) -> None:
        """The first sample belongs to `tick`."""
        self._first = tick
        self.freshness = Freshness.LIVE

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Value of this tick."""
        k = tick - self._first - len(self._run_in)
        if k < 0:
            self.ahead = self._run_in[k]
            return self._values[0]
        if k >= len(self._values):
            if not self._loop:
                self.freshness = Freshness.ENDED
                k = len(self._values) - 1
            k %= len(self._values)
        self.ahead = self._ahead[k]
        return self._values[k]

    def close(self) -> None:
        """Nothing was opened."""


def _packed(values: NDArray[np.float64]) -> "memoryview[float]":
    return memoryview(np.ascontiguousarray(values).tobytes()).cast("d")


class LiveReading:
    """The `reference` register of the block that the tick reads anyway.

    Parameters
    ----------
    reading
        The link's reading, overwritten in place by every good exchange.
    config
        Stale time and what follows.
    counted
        Whether `reference_counter` is there: then its standing still makes the reference stale.
    """

    def __init__(self, reading: Reading, config: RegisterReference, *, counted: bool) -> None:
        self._reading = reading
        self._stale_ns = round(config.stale_after_s * 1e9)
        self._counted = counted
        self._counter = -1
        self._heard_ns = 0
        self.ahead = 0.0
        self.ramp_down_on_lapse = config.when_stale == "ramp_down"
        self.freshness = Freshness.STALE

    def start(self, tick: int) -> None:  # noqa: ARG002  # the same call for every reference
        """Whatever the register holds now counts as heard."""
        self._counter = -1

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Value of the last good reading [N]."""
        reading = self._reading
        if not self._counted or reading.reference_counter != self._counter:
            self._counter = reading.reference_counter
            if isfinite(reading.reference_N):
                self.ahead = reading.reference_N
                self._heard_ns = now_ns
        self.freshness = Freshness.LIVE if now_ns - self._heard_ns < self._stale_ns else Freshness.STALE
        return self.ahead

    def close(self) -> None:
        """Nothing was opened."""


class DatagramStream:
    """Datagrams of 24 bytes, little-endian: sequence (uint64), timestamp [ns] (uint64), value [N] (float64).

    Every tick takes what has come, keeps the highest sequence number and counts what was out of order or malformed.

    Raises
    ------
    BusyError
        The address is taken.
    """

    _DATAGRAM = struct.Struct("<QQd")
    _MOST_A_TICK = 32

    def __init__(self, config: StreamReference) -> None:
        self._stale_ns = round(config.stale_after_s * 1e9)
        self._buffer = bytearray(64)
        self._sequence = -1
        self._heard_ns: int | None = None
        self.ahead = 0.0
        self._path: Path | None = None
        self.rejected = 0
        self.ramp_down_on_lapse = config.when_stale == "ramp_down"
        self.freshness = Freshness.STALE
        self._socket = self._bind(config)

    def _bind(self, config: StreamReference) -> socket.socket:
        address = config.udp_address
        if address is None:
            receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._path = Path(config.listen)
            self._path.unlink(missing_ok=True)
        else:
            receiver = socket.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            receiver.bind(config.listen if address is None else address)
        except OSError as error:
            receiver.close()
            raise BusyError(f"reference.listen: {config.listen} cannot be bound: {error.strerror}") from error
        receiver.setblocking(False)
        return receiver

    def start(self, tick: int) -> None:
        """Nothing to align: values count when they come."""

    def read(self, tick: int, now_ns: int) -> float:  # noqa: ARG002  # the same call for every reference
        """Newest value [N]."""
        for _ in range(self._MOST_A_TICK):
            try:
                size = self._socket.recv_into(self._buffer)
            except (BlockingIOError, InterruptedError):
                break
            self._take(size, now_ns)
        heard = self._heard_ns
        live = heard is not None and now_ns - heard < self._stale_ns
        self.freshness = Freshness.LIVE if live else Freshness.STALE
        return self.ahead

    def _take(self, size: int, now_ns: int) -> None:
        if size != self._DATAGRAM.size:
            self.rejected += 1
            return
        sequence, _, value = self._DATAGRAM.unpack_from(self._buffer)
        if sequence <= self._sequence or not isfinite(value):
            self.rejected += 1
            return
        self._sequence, self.ahead, self._heard_ns = sequence, value, now_ns

    def close(self) -> None:
        """Close the socket and remove a unix socket's path."""
        self._socket.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def waveform_table(config: WaveformReference, rate_Hz: float) -> TableReference:
    """Table of a built-in waveform, looped over whole periods when it has no duration.

    Raises
    ------
    ConfigurationError
        The waveform is too fast for the tick, or too long to be kept.
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
        raise ConfigurationError(f"reference: {ticks} ticks, at most {MOST_TICKS} are kept; shorten duration_s")
    phase = np.arange(ticks, dtype=np.float64) * (periods / ticks)
    unit = shape(config.kind, phase, levels=config.levels, seed=config.seed)
    values = config.offset_N + config.amplitude_N * unit
    return TableReference(values, loop=config.duration_s is None, ramp_down_on_lapse=config.at_end == "ramp_down")


def file_table(config: FileReference, rate_Hz: float, folder: Path) -> TableReference:
    """Table of a recording's column, interpolated to the tick.

    Raises
    ------
    ConfigurationError
        The recording cannot be read, or has no such column.
    """
    try:
        recording = read_csv(folder / config.path)
        column = recording.channel(config.column)
    except RecordingError as error:
        raise ConfigurationError(f"reference.path: {error}") from error
    time_s = recording.time_s - recording.time_s[0]
    ticks = np.arange(int(time_s[-1] * rate_Hz) + 1) / rate_Hz
    values = np.interp(ticks, time_s, column) * config.scale + config.offset_N
    return TableReference(values, loop=config.loop, ramp_down_on_lapse=config.at_end == "ramp_down")


def make_reference(
    config: ReferenceConfig, rate_Hz: float, folder: Path, reading: Reading, *, counted: bool
) -> Reference:
    """Build the reference that the bench configuration names.

    Parameters
    ----------
    config
        The `reference` section.
    rate_Hz
        Ticks per second.
    folder
        Where relative paths start.
    reading
        The link's reading, for a reference in a register.
    counted
        Whether the link reads `reference_counter`.

    Raises
    ------
    ConfigurationError
        A file cannot be read.
    BusyError
        The stream's address is taken.
    """
    if isinstance(config, WaveformReference):
        return waveform_table(config, rate_Hz)
    if isinstance(config, FileReference):
        return file_table(config, rate_Hz, folder)
    if isinstance(config, RegisterReference):
        return LiveReading(reading, config, counted=counted)
    return DatagramStream(config)
