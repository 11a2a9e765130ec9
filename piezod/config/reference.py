"""The `reference` section: the source of the reference force."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Positive, Section, require

EndAction = Literal["hold", "ramp_down"]
MOST_BYTES = 1 << 26
"""Largest reference file [byte]: two million rows of four columns; reading takes up to 8 s and 0.8 GB."""


class _LimitedReference(Section):
    """Keys of every source: the permitted range of forces; None: the force limits of the bench."""

    low_N: float | None = None
    high_N: float | None = None

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Self:
        if self.low_N is not None and self.high_N is not None:
            require(self.low_N < self.high_N, "low_N", self.low_N, f"below high_N, {self.high_N:g}")
        return self


class WaveformReference(_LimitedReference):
    """A built-in waveform: `offset_N` + `amplitude_N` * shape [N], with the shape between -1 and 1."""

    kind: Literal["triangle", "sine", "staircase", "steps", "multisine"]
    amplitude_N: Annotated[float, Field(ge=0)]
    offset_N: float
    frequency_Hz: Positive
    duration_s: Positive | None = None
    levels: Annotated[int, Field(ge=2, le=1000)] = 8
    seed: Annotated[int, Field(ge=0)] = 1
    at_end: EndAction = "ramp_down"


class FileReference(_LimitedReference):
    """A column of a CSV file, interpolated at the ticks: `value * scale + offset_N` [N]. The file is read strictly.

    `longest_step_s`: longest time between two rows; None: ten times the median, 1.5 times it for evenly spaced rows.
    `closing_row`: use of the last row of a loop if it equals the first; drop: the first row of the next pass; keep: a
    sample of its own.
    """

    kind: Literal["file"]
    path: Annotated[str, Field(min_length=1)]
    column: str = "reference_N"
    scale: float = 1.0
    offset_N: float = 0.0
    loop: bool = False
    closing_row: Literal["drop", "keep"] | None = None
    longest_step_s: Positive | None = None
    at_end: EndAction = "ramp_down"

    @model_validator(mode="after")
    def _closing_row_needs_a_loop(self) -> Self:
        if self.closing_row is not None and not self.loop:
            raise ValueError(f"closing_row is {self.closing_row}, must be null where loop is false")
        return self


def is_looped(reference: "ReferenceConfig") -> bool:
    """Whether the values of a reference are known ahead and begin again at the end.

    Parameters
    ----------
    reference
        Section `reference` of the bench configuration.
    """
    if isinstance(reference, FileReference):
        return reference.loop
    return isinstance(reference, WaveformReference) and reference.duration_s is None


class RegisterReference(_LimitedReference):
    """The `reference` register, written by a PLC; stale when `reference_counter` does not change."""

    kind: Literal["register"]
    stale_after_s: Positive = 0.5
    when_stale: EndAction = "hold"


class StreamReference(_LimitedReference):
    """Datagrams, little-endian: sequence number (uint64), time [ns] (uint64), force [N] (float64).

    A session number (uint64) may precede them. With `key_file` it must, and an authentication tag of 16 bytes follows.
    """

    kind: Literal["stream"]
    listen: Annotated[str, Field(min_length=1)]
    stale_after_s: Positive = 0.1
    when_stale: EndAction = "hold"
    key_file: Annotated[str, Field(pattern=r"^(/|\$CREDENTIALS_DIRECTORY/).+")] | None = None
    stamp_within_s: Positive | None = None
    socket_group: Annotated[str, Field(min_length=1)] | None = None
    socket_mode: Annotated[str, Field(pattern=r"^0?[0-7]{3}$")] = "0660"

    @property
    def udp_address(self) -> tuple[str, int] | None:
        """Host and port of `udp://HOST:PORT`; None for the path of a Unix socket."""
        if not self.listen.startswith("udp://"):
            return None
        host, _, port = self.listen.removeprefix("udp://").rpartition(":")
        return host.strip("[]"), int(port)

    @model_validator(mode="after")
    def _address_is_udp_or_path(self) -> Self:
        if self.listen.startswith("/"):
            return self
        try:
            address = self.udp_address
        except ValueError:
            address = None
        if address is None or not address[0] or not 0 < address[1] < 65536:
            raise ValueError(f"listen is '{self.listen}', must be udp://HOST:PORT or an absolute path")
        return self


ReferenceConfig = Annotated[
    WaveformReference | FileReference | RegisterReference | StreamReference, Field(discriminator="kind")
]
