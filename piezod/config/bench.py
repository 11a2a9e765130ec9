"""The bench configuration: everything that `piezod run` needs to know, cross-checked before anything is energised."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section, check, shortened
from piezod.config.drift import DriftConfig
from piezod.config.limits import LimitsConfig
from piezod.config.link import LinkConfig, ModbusRtuLink, ModbusTcpLink, Registers, SerialLineLink
from piezod.config.recorder import RecorderConfig
from piezod.config.reference import ReferenceConfig, RegisterReference
from piezod.config.yaml_reader import Document, read_document
from piezod.errors import ConfigurationError

SCHEMA = "piezod.bench/1"


class RealTimeConfig(Section):
    """What the control process asks of the kernel; each is optional and warned about when the right is missing."""

    fifo_priority: Annotated[int, Field(ge=0, le=99)] = 80
    lock_memory: bool = True
    cpu: Annotated[int, Field(ge=0)] | None = None
    hold_cpu_latency: bool = True


class SignCheckConfig(Section):
    """The step that must raise the force before anything else is driven: polarity, cable and preload in one."""

    step_V: Annotated[float, Field(gt=0)] = 2.0
    rise_N: Annotated[float, Field(gt=0)] = 0.5
    settle_s: Annotated[float, Field(gt=0, le=60)] = 0.1


Precondition = Literal["identity", "map_version", "device_watchdog", "voltage_readback", "sign_check"]


class ArmingConfig(Section):
    """What must hold before a voltage is written, and how the bench is brought from rest to the first reference.

    `without` names the preconditions that this device cannot meet; each is one thing that will not be noticed.
    """

    reset_cycle: bool = True
    voltage_V_per_s: Annotated[float, Field(gt=0)] = 200.0
    readback_within_V: Annotated[float, Field(gt=0)] = 2.0
    agree_within_N: Annotated[float, Field(gt=0)] | None = None
    sign_check: SignCheckConfig = SignCheckConfig()
    without: Annotated[tuple[Precondition, ...], Field(strict=False)] = ()


class DaemonConfig(Section):
    """Where the daemon keeps what it shows to others, and where it listens."""

    ring_log: str = "/dev/shm/piezod-{name}.ring"  # noqa: S108  # shared memory is meant to be seen
    ring_seconds: Annotated[float, Field(gt=0, le=3600)] = 60.0
    socket: str | None = None
    socket_group: Annotated[str, Field(min_length=1)] | None = None
    socket_mode: Annotated[str, Field(pattern=r"^0?[0-7]{3}$")] = "0660"
    metrics_port: Annotated[int, Field(ge=0, le=65535)] | None = None


class BenchConfig(Section):
    """One bench.

    `compensation_without` names effects of the model that are knowingly not driven against: those that have no
    inverse, or whose inverse is not wanted.
    """

    schema_: Annotated[Literal["piezod.bench/1"], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    rate_Hz: Annotated[float, Field(gt=0, le=20_000)]
    model: Annotated[str, Field(min_length=1)]
    compensation: Literal["inverse", "gain"] = "inverse"
    compensation_without: Annotated[tuple[str, ...], Field(strict=False)] = ()
    link: LinkConfig
    load_cell_link: LinkConfig | None = None
    limits: LimitsConfig
    arming: ArmingConfig = ArmingConfig()
    reference: ReferenceConfig
    real_time: RealTimeConfig = RealTimeConfig()
    daemon: DaemonConfig = DaemonConfig()
    recorder: RecorderConfig | None = None
    drift: DriftConfig | None = DriftConfig()

    @property
    def dt_s(self) -> float:
        """The tick's period [s]."""
        return 1.0 / self.rate_Hz

    @property
    def ring_log_path(self) -> Path:
        """Where the ring log lies."""
        return Path(self.daemon.ring_log.replace("{name}", self.name))

    @property
    def lock_path(self) -> Path:
        """What a program holds while it drives or watches this bench: beside the ring log."""
        return self.ring_log_path.with_name(self.ring_log_path.name + ".lock")

    @property
    def socket_path(self) -> Path:
        """Where the daemon is spoken to: beside the ring log unless named."""
        if self.daemon.socket is None:
            return self.ring_log_path.with_name(self.ring_log_path.name + ".sock")
        return Path(self.daemon.socket.replace("{name}", self.name))

    @property
    def recordings_path(self) -> Path | None:
        """Folder that every tick is recorded in; None: nothing is."""
        return None if self.recorder is None else Path(self.recorder.folder.replace("{name}", self.name))

    def names(self, role: str) -> bool:
        """Whether amplifier or load cell has something for this role."""
        return self.link.names(role) or (self.load_cell_link is not None and self.load_cell_link.names(role))

    @model_validator(mode="after")
    def _link_has_what_the_loop_needs(self) -> Self:
        _require_voltage(self.link)
        _require_force(self.load_cell_link or self.link, "load_cell_link" if self.load_cell_link else "link")
        if isinstance(self.reference, RegisterReference):
            source = self.load_cell_link or self.link
            registers = None if isinstance(source, SerialLineLink) else source.registers
            if registers is None or registers.reference is None:
                raise ValueError("reference.kind is register, but the link's registers name no 'reference'")
        return self

    @model_validator(mode="after")
    def _arming_is_within_limits(self) -> Self:
        if self.arming.voltage_V_per_s > self.limits.slew_V_per_s:
            raise ValueError(
                f"arming.voltage_V_per_s is {self.arming.voltage_V_per_s:g}, must be at most limits.slew_V_per_s, "
                f"{self.limits.slew_V_per_s:g}"
            )
        highest_V = self.limits.voltage_max_V - self.limits.voltage_safe_V
        if self.arming.sign_check.step_V > highest_V:
            raise ValueError(
                f"arming.sign_check.step_V is {self.arming.sign_check.step_V:g}, must be at most {highest_V:g}, from "
                "the safe voltage to limits.voltage_max_V"
            )
        return self

    @model_validator(mode="after")
    def _limits_can_be_watched(self) -> Self:
        for limit, role in (("readback_trip_V", "voltage_readback"), ("temperature_trip_degC", "temperature")):
            if getattr(self.limits, limit) is not None and not self.names(role):
                raise ValueError(
                    f"limits.{limit} is {getattr(self.limits, limit):g}, but the link reads no {role}; "
                    f"name it, or set {limit}: null"
                )
        return self

    @model_validator(mode="after")
    def _a_force_above_the_trip_can_be_read(self) -> Self:
        """A reading outside low..high is refused as impossible, so a trip outside it would never be seen."""
        link, limits = self.load_cell_link or self.link, self.limits
        force = None if isinstance(link, SerialLineLink) else link.registers.force
        if force is not None and force.high is not None and limits.force_trip_N >= force.high:
            raise ValueError(
                f"limits.force_trip_N is {limits.force_trip_N:g}, must be below registers.force.high, {force.high:g}"
            )
        if force is not None and force.low is not None and limits.force_min_N <= force.low:
            raise ValueError(
                f"limits.force_min_N is {limits.force_min_N:g}, must be above registers.force.low, {force.low:g}"
            )
        return self

    @model_validator(mode="after")
    def _a_tick_moves_at_least_one_converter_step(self) -> Self:
        for name, rate in (
            ("limits.slew_V_per_s", self.limits.slew_V_per_s),
            ("limits.slew_down_V_per_s", self.limits.fall_V_per_s),
            ("limits.ramp_down_V_per_s", self.limits.ramp_down_V_per_s),
            ("arming.voltage_V_per_s", self.arming.voltage_V_per_s),
        ):
            if self.limits.voltage_step_V > rate * self.dt_s:
                raise ValueError(
                    f"limits.voltage_step_V is {self.limits.voltage_step_V:g}, must be at most one tick of {name}, "
                    f"{rate * self.dt_s:g} V: the output would never move"
                )
        return self

    @model_validator(mode="after")
    def _a_watchdog_can_be_set(self) -> Self:
        if self.limits.device_watchdog_ms and not self.link.names("watchdog_ms"):
            raise ValueError(
                f"limits.device_watchdog_ms is {self.limits.device_watchdog_ms}, but the link names no watchdog to be "
                "set; name its register, or set 0 and set the device's own by hand"
            )
        return self

    @model_validator(mode="after")
    def _a_slow_disk_is_outlived(self) -> Self:
        recorder = self.recorder
        if recorder is not None and self.daemon.ring_seconds < 4 * recorder.sync_every_s:
            raise ValueError(
                f"daemon.ring_seconds is {self.daemon.ring_seconds:g}, must be at least four times "
                f"recorder.sync_every_s, {4 * recorder.sync_every_s:g}: ticks would be lost between two looks"
            )
        return self

    @model_validator(mode="after")
    def _watchdog_outlives_a_tick(self) -> Self:
        watchdog_ms = self.limits.device_watchdog_ms
        tick_ms = 1000.0 / self.rate_Hz
        if watchdog_ms and watchdog_ms <= 2 * tick_ms:
            raise ValueError(
                f"limits.device_watchdog_ms is {watchdog_ms}, must be above two ticks, {2 * tick_ms:g} ms at "
                f"rate_Hz {self.rate_Hz:g}"
            )
        if self.limits.comm_loss_ms < tick_ms:
            raise ValueError(
                f"limits.comm_loss_ms is {self.limits.comm_loss_ms:g}, must be at least one tick, {tick_ms:g} ms"
            )
        if self.limits.stale_after_ms < tick_ms:
            raise ValueError(
                f"limits.stale_after_ms is {self.limits.stale_after_ms:g}, must be at least one tick, {tick_ms:g} ms: "
                "every reading would be stale"
            )
        if (2 + self.limits.force_debounce_samples) * tick_ms > self.limits.comm_loss_ms:
            raise ValueError(
                f"limits.force_debounce_samples is {self.limits.force_debounce_samples}, which is "
                f"{self.limits.force_debounce_samples * tick_ms:g} ms, must be two ticks below limits.comm_loss_ms, "
                f"{self.limits.comm_loss_ms:g}"
            )
        return self


def _require_voltage(link: ModbusTcpLink | ModbusRtuLink | SerialLineLink) -> None:
    if isinstance(link, SerialLineLink):
        if link.set_voltage is None:
            raise ValueError("link.set_voltage is missing: nothing could be driven")
    elif link.registers.voltage_setpoint is None:
        raise ValueError("link.registers.voltage_setpoint is missing: nothing could be driven")


def _require_force(link: ModbusTcpLink | ModbusRtuLink | SerialLineLink, name: str) -> None:
    if isinstance(link, SerialLineLink):
        if link.measure is None or link.measure.reply is None or "(?P<force_N>" not in link.measure.reply:
            raise ValueError(
                f"{name}.measure.reply needs a group (?P<force_N>...): without it no force is read; "
                "name a load_cell_link if another device measures it"
            )
    elif link.registers.force is None:
        raise ValueError(
            f"{name}.registers.force is missing: no force is read; name a load_cell_link if another device measures it"
        )


def load_bench(path: Path) -> BenchConfig:
    """Read and check a bench configuration.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit.
    """
    return bench_of(read_document(path))


def bench_of(document: Document) -> BenchConfig:
    """Check what was read from a bench file.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit.
    """
    schema = document.content.get("schema")
    if schema != SCHEMA:
        raise ConfigurationError(f"{document.path}: schema is {shortened(schema)}, must be '{SCHEMA}'")
    return check(document, BenchConfig)


def model_path(bench: BenchConfig, bench_path: Path) -> Path:
    """Where the model lies: beside the bench configuration unless absolute."""
    return bench_path.parent / bench.model


__all__ = ["BenchConfig", "RealTimeConfig", "Registers", "load_bench", "model_path"]
