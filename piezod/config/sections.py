"""The sections `real_time`, `arming`, `daemon`, `recorder`, `drift` and `learning` of a bench file."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Positive, Section, require

Precondition = Literal["identity", "map_version", "device_watchdog", "voltage_readback", "sign_check"]


class RealTimeConfig(Section):
    """Real-time settings that the control process requests from the kernel; a missing right gives a warning."""

    fifo_priority: Annotated[int, Field(ge=0, le=99)] = 80
    lock_memory: bool = True
    cpu: Annotated[int, Field(ge=0)] | None = None
    hold_cpu_latency: bool = True


class SignCheckConfig(Section):
    """A small voltage step that must raise the force: it tests polarity, cable and preload before anything else."""

    step_V: Positive = 2.0
    rise_N: Positive = 0.5
    settle_s: Annotated[float, Field(gt=0, le=60)] = 0.1


class ArmingConfig(Section):
    """Conditions before the first voltage is written, and the way from rest to the first reference.

    `without` lists the preconditions that this device cannot fulfil. The corresponding faults stay undetected.
    """

    reset_cycle: bool = True
    voltage_V_per_s: Positive = 200.0
    readback_within_V: Positive = 2.0
    agree_within_N: Positive | None = None
    sign_check: SignCheckConfig = SignCheckConfig()
    without: Annotated[tuple[Precondition, ...], Field(strict=False)] = ()


class DaemonConfig(Section):
    """Ring log, control socket and metrics port of the daemon."""

    ring_log: str = "/dev/shm/piezod-{name}.ring"  # noqa: S108  # other programs read this shared memory
    ring_seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0
    socket: str | None = None
    socket_group: Annotated[str, Field(min_length=1)] | None = None
    socket_mode: Annotated[str, Field(pattern=r"^0?[0-7]{3}$")] = "0660"
    metrics_port: Annotated[int, Field(ge=0, le=65535)] | None = None
    slow_phase_ms: Positive | None = None
    railed_after_s: Annotated[float, Field(gt=0, le=3600)] = 1.0


class RecorderConfig(Section):
    """Folder with files of ticks; the oldest file is deleted when the folder reaches its limit.

    `keep_around_s` is the time before and after the begin of a fault that gets a file of its own [s]; None: none.
    """

    folder: Annotated[str, Field(min_length=1)]
    sync_every_s: Annotated[float, Field(ge=0.05, le=60)] = 0.5
    file_MB: Annotated[float, Field(ge=8, le=100_000)] = 256.0
    file_h: Annotated[float, Field(gt=0, le=8760)] = 24.0
    folder_MB: Annotated[float, Field(ge=16)] = 10_000.0
    keep_around_s: Annotated[float, Field(ge=1, le=60)] | None = None

    @model_validator(mode="after")
    def _folder_holds_two_files(self) -> Self:
        least_MB = 2 * self.file_MB
        limit = f"at least two files of file_MB, {least_MB:g}: the previous file stays while the next is written"
        require(self.folder_MB >= least_MB, "folder_MB", self.folder_MB, limit)
        return self


class DriftConfig(Section):
    """Comparison of force and model in windows of time, and the recording saved when they differ.

    `beyond_N` is the difference [N] that counts as drift in the first stretch of driving; None: three times the model's
    held-out error. `false_alarm_days` is the mean time of driving between two false alarms [day]. An error that grows
    by the share `tolerance` is no drift. `blocks` is the file of the known windows; None: beside the ring log.
    """

    window_s: Annotated[float, Field(ge=1, le=3600)] = 10.0
    beyond_N: Positive | None = None
    false_alarm_days: Annotated[float, Field(ge=1, le=36500)] = 365.0
    tolerance: Annotated[float, Field(ge=0, le=10)] = 0.05
    keep_s: Annotated[float, Field(ge=10, le=3600)] = 120.0
    file: str | None = None
    blocks: str | None = None


class ProofConfig(Section):
    """Date on which the proof test of the interlocks is due again.

    `interval_days` is the time from one proof test to the next [day]. `folder` holds the records; None: the folder of
    the bench file.
    """

    interval_days: Annotated[float, Field(gt=0, le=36500)] = 365.0
    folder: Annotated[str, Field(min_length=1)] | None = None


class LearningConfig(Section):
    """Learning of a looped reference from one repeat to the next.

    `most_N` is the largest correction [N]; None: a quarter of the span of the reference. `file` keeps the correction.
    """

    most_N: Positive | None = None
    file: str | None = None
