"""The `reference` section: where the force to be followed comes from."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section

Positive = Annotated[float, Field(gt=0)]
Lapse = Literal["hold", "ramp_down"]


class WaveformReference(Section):
    """A built-in waveform [N]: `offset_N` + `amplitude_N` x shape, the shape within -1 and 1."""

    kind: Literal["triangle", "sine", "staircase", "steps", "multisine"]
    amplitude_N: Annotated[float, Field(ge=0)]
    offset_N: float
    frequency_Hz: Positive
    duration_s: Positive | None = None
    levels: Annotated[int, Field(ge=2, le=1000)] = 8
    seed: Annotated[int, Field(ge=0)] = 1
    at_end: Lapse = "ramp_down"


class FileReference(Section):
    """A column of a recording, interpolated to the tick: `value * scale + offset_N`."""

    kind: Literal["file"]
    path: Annotated[str, Field(min_length=1)]
    column: str = "reference_N"
    scale: float = 1.0
    offset_N: float = 0.0
    loop: bool = False
    at_end: Lapse = "ramp_down"


class RegisterReference(Section):
    """The `reference` register, written by the test bench's PLC; stale when `reference_counter` stands still."""

    kind: Literal["register"]
    stale_after_s: Positive = 0.5
    when_stale: Lapse = "hold"


class StreamReference(Section):
    """Datagrams of 24 bytes, little-endian: sequence number (uint64), timestamp [ns] (uint64), value [N] (float64)."""

    kind: Literal["stream"]
    listen: Annotated[str, Field(min_length=1)]
    stale_after_s: Positive = 0.1
    when_stale: Lapse = "hold"

    @property
    def udp_address(self) -> tuple[str, int] | None:
        """Host and port of `udp://HOST:PORT`, None for a unix socket's path."""
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
