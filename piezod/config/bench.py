"""The bench configuration: every setting that `piezod run` needs, cross-checked before any voltage is written."""

import os
from math import inf
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section, check, require, shortened
from piezod.config.limits import LimitsConfig
from piezod.config.link import AnyLink, LinkConfig, SerialLineLink
from piezod.config.reference import ReferenceConfig, RegisterReference, StreamReference, is_looped
from piezod.config.reference_range import ReferenceRange, reference_range
from piezod.config.sections import (
    ArmingConfig,
    DaemonConfig,
    DriftConfig,
    LearningConfig,
    ProofConfig,
    RealTimeConfig,
    RecorderConfig,
)
from piezod.config.yaml_reader import Document, read_document
from piezod.errors import ConfigurationError

SCHEMA = "piezod.bench/1"


class BenchConfig(Section):
    """All settings of one bench.

    `compensation_without` lists effects of the model that are deliberately not compensated: effects without an inverse,
    or with an unwanted inverse.
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
    learning: LearningConfig | None = None
    proof: ProofConfig | None = None

    @property
    def dt_s(self) -> float:
        """Tick period [s]."""
        return 1.0 / self.rate_Hz

    @property
    def ring_log_path(self) -> Path:
        """Path of the ring log."""
        return Path(self.daemon.ring_log.replace("{name}", self.name))

    @property
    def lock_path(self) -> Path:
        """Lock file next to the ring log; a program holds it while it drives or watches this bench."""
        return self.ring_log_path.with_name(self.ring_log_path.name + ".lock")

    @property
    def socket_path(self) -> Path:
        """Path of the daemon's control socket; next to the ring log unless configured."""
        return self._path_of(self.daemon.socket, ".sock")

    @property
    def stop_socket_path(self) -> Path:
        """Path of the socket that only stops (`daemon/stop_path.py`), next to the control socket."""
        return self.socket_path.with_name(self.socket_path.name + ".stop")

    @property
    def learned_path(self) -> Path:
        """File of the learned correction: `learning.file`, or a file next to the ring log."""
        return self._path_of(None if self.learning is None else self.learning.file, ".learned.csv")

    @property
    def drift_path(self) -> Path:
        """File for the recording of a bench that has drifted: `drift.file`, or a file next to the ring log."""
        return self._path_of(None if self.drift is None else self.drift.file, ".drift.csv")

    @property
    def blocks_path(self) -> Path:
        """File of the windows that the drift watch knows: `drift.blocks`, or a file next to the ring log."""
        return self._path_of(None if self.drift is None else self.drift.blocks, ".blocks.csv")

    def _path_of(self, name: str | None, suffix: str) -> Path:
        """Path of a file from the configuration, else next to the ring log."""
        if name is None:
            return self.ring_log_path.with_name(self.ring_log_path.name + suffix)
        return Path(name.replace("{name}", self.name))

    @property
    def recordings_path(self) -> Path | None:
        """Folder of the recorded ticks; None: no recording."""
        return None if self.recorder is None else Path(self.recorder.folder.replace("{name}", self.name))

    def has_role(self, role: str) -> bool:
        """Whether the amplifier or the load cell has a register or reply field for this role."""
        return self.link.has_role(role) or (self.load_cell_link is not None and self.load_cell_link.has_role(role))

    @model_validator(mode="after")
    def _link_has_the_roles_of_the_loop(self) -> Self:
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
        arming, limits = self.arming, self.limits
        rate, step_V = arming.voltage_V_per_s, arming.sign_check.step_V
        slew = f"at most limits.slew_V_per_s, {limits.slew_V_per_s:g}"
        require(rate <= limits.slew_V_per_s, "arming.voltage_V_per_s", rate, slew)
        highest_V = limits.voltage_max_V - limits.voltage_safe_V
        highest = f"at most {highest_V:g}, from the safe voltage to limits.voltage_max_V"
        require(step_V <= highest_V, "arming.sign_check.step_V", step_V, highest)
        return self

    @property
    def reference_range(self) -> ReferenceRange:
        """Range of forces that the reference may ask for."""
        return reference_range(self.reference, self.limits, self._readable_N)

    @property
    def _readable_N(self) -> tuple[float | None, float | None]:
        """Lowest and highest force that the register can show [N]; None: unknown."""
        link = self.load_cell_link or self.link
        force = None if isinstance(link, SerialLineLink) else link.registers.force
        return (None, None) if force is None else (force.low, force.high)

    @model_validator(mode="after")
    def _reference_is_in_range(self) -> Self:
        assert self.reference_range is not None  # raises ValueError for a waveform beyond its bounds
        return self

    @model_validator(mode="after")
    def _limited_quantities_are_read(self) -> Self:
        for limit, role in (("readback_trip_V", "voltage_readback"), ("temperature_trip_degC", "temperature")):
            value = getattr(self.limits, limit)
            if value is not None and not self.has_role(role):
                raise ValueError(
                    f"limits.{limit} is {value:g}, but the link reads no {role}; name it, or set {limit}: null"
                )
        return self

    @model_validator(mode="after")
    def _force_limits_lie_within_the_readable_range(self) -> Self:
        """Require trip limits inside low..high: a reading outside low..high is discarded and would never trip."""
        limits, (low_N, high_N) = self.limits, self._readable_N
        if high_N is not None:
            below = f"below registers.force.high, {high_N:g}"
            require(limits.force_trip_N < high_N, "limits.force_trip_N", limits.force_trip_N, below)
        if low_N is not None:
            above = f"above registers.force.low, {low_N:g}"
            require(limits.force_min_N > low_N, "limits.force_min_N", limits.force_min_N, above)
        return self

    @model_validator(mode="after")
    def _every_limit_can_act(self) -> Self:
        """Refuse a limit that nothing can reach: it would monitor nothing, and look as if it did."""
        limits, (low_N, high_N) = self.limits, self._readable_N
        span_N = inf if low_N is None or high_N is None else high_N - low_N
        turn, span_V = 2.0 * limits.slew_V_per_s / self.dt_s, limits.voltage_max_V - limits.voltage_min_V
        for name, most, why in (
            ("acceleration_V_per_s2", turn, "two slews in a tick"),
            ("deceleration_V_per_s2", turn, "two slews in a tick"),
            ("force_rate_trip_N_per_s", 10.0 * span_N / self.dt_s, "ten times the range of registers.force in a tick"),
            ("tracking_trip_N", span_N, "the range of registers.force"),
            ("stuck_travel_V", span_V if limits.stuck_samples else inf, "voltage_min_V to voltage_max_V"),
        ):
            if (value := getattr(limits, name)) is not None:
                limit = f"at most {most:g}, {why}: it can never act; lower it, or write null"
                require(value <= most, f"limits.{name}", value, limit)
        return self

    @model_validator(mode="after")
    def _tick_moves_a_converter_step(self) -> Self:
        for name, rate in (
            ("limits.slew_V_per_s", self.limits.slew_V_per_s),
            ("limits.slew_down_V_per_s", self.limits.fall_V_per_s),
            ("limits.ramp_down_V_per_s", self.limits.ramp_down_V_per_s),
            ("arming.voltage_V_per_s", self.arming.voltage_V_per_s),
        ):
            most_V, step_V = rate * self.dt_s, self.limits.voltage_step_V
            limit = f"at most one tick of {name}, {most_V:g} V: the output would never move"
            require(step_V <= most_V, "limits.voltage_step_V", step_V, limit)
        return self

    @model_validator(mode="after")
    def _the_watchdog_has_a_register(self) -> Self:
        if self.limits.device_watchdog_ms and not self.link.has_role("watchdog_ms"):
            raise ValueError(
                f"limits.device_watchdog_ms is {self.limits.device_watchdog_ms}, but the link has no watchdog_ms; add "
                "its register, or write 0 and set the watchdog on the device"
            )
        return self

    @model_validator(mode="after")
    def _the_ring_holds_four_recorder_periods(self) -> Self:
        if self.recorder is not None:
            least_s = 4 * self.recorder.sync_every_s
            limit = f"at least four times recorder.sync_every_s, {least_s:g}: a slow disk would lose ticks"
            require(self.daemon.ring_seconds >= least_s, "daemon.ring_seconds", self.daemon.ring_seconds, limit)
        return self

    @model_validator(mode="after")
    def _learning_needs_repeats(self) -> Self:
        if self.learning is not None and not is_looped(self.reference):
            raise ValueError(
                f"learning needs a reference that repeats, reference.kind is {self.reference.kind}: use a waveform "
                "with duration_s: null, or a file with loop: true, or write learning: null"
            )
        return self

    @model_validator(mode="after")
    def _run_time_files_differ(self) -> Self:
        paths = {"daemon.ring_log": self.ring_log_path, "its lock": self.lock_path, "daemon.socket": self.socket_path}
        if isinstance(self.reference, StreamReference) and self.reference.udp_address is None:
            paths["reference.listen"] = Path(self.reference.listen)
        if self.drift is not None and self.drift.file is not None:
            paths["drift.file"] = self.drift_path
        if self.drift is not None and self.drift.blocks is not None:
            paths["drift.blocks"] = self.blocks_path
        if self.learning is not None:
            paths["learning.file"] = self.learned_path
        names: dict[Path, str] = {}
        for name, path in paths.items():
            if (other := names.setdefault(path, name)) != name:
                raise ValueError(f"{name} is {path}, the same as {other}; name another path")
        return self

    @model_validator(mode="after")
    def _times_fit_the_tick(self) -> Self:
        limits, tick_ms = self.limits, 1000.0 / self.rate_Hz
        watchdog_ms, comm_loss_ms, stale_ms = limits.device_watchdog_ms, limits.comm_loss_ms, limits.stale_after_ms
        two_ticks = f"above two ticks, {2 * tick_ms:g} ms at rate_Hz {self.rate_Hz:g}"
        require(not 0 < watchdog_ms <= 2 * tick_ms, "limits.device_watchdog_ms", watchdog_ms, two_ticks)
        one_tick = f"at least one tick, {tick_ms:g} ms"
        require(comm_loss_ms >= tick_ms, "limits.comm_loss_ms", comm_loss_ms, one_tick)
        require(stale_ms >= tick_ms, "limits.stale_after_ms", stale_ms, f"{one_tick}: every reading would be stale")
        samples = limits.force_debounce_samples
        debounce_ms = samples * tick_ms
        if debounce_ms + 2 * tick_ms > comm_loss_ms:
            raise ValueError(
                f"limits.force_debounce_samples is {samples}, which is {debounce_ms:g} ms, must be two ticks below "
                f"limits.comm_loss_ms, {comm_loss_ms:g}"
            )
        return self


def _require_voltage(link: AnyLink) -> None:
    if isinstance(link, SerialLineLink):
        if link.set_voltage is None:
            raise ValueError("link.set_voltage is missing: no voltage can be written")
    elif link.registers.voltage_setpoint is None:
        raise ValueError("link.registers.voltage_setpoint is missing: no voltage can be written")


def _require_force(link: AnyLink, name: str) -> None:
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
    document = read_document(path)
    bench = bench_of(document)
    _check_cpu(bench, document)
    return bench


def _check_cpu(bench: BenchConfig, document: Document) -> None:
    """Refuse a `real_time.cpu` that this machine does not have; the kernel would leave the loop on any CPU."""
    cpu, count = bench.real_time.cpu, os.cpu_count()
    if cpu is not None and count is not None and cpu >= count:
        line = document.line_of(["real_time", "cpu"])
        raise ConfigurationError(
            f"{document.path}:{line}: real_time.cpu is {cpu}, must be at most {count - 1}: this machine has {count} "
            "CPUs; name one of them, or null"
        )


def bench_of(document: Document) -> BenchConfig:
    """Validate a bench file that is already read.

    Parameters
    ----------
    document
        Path, content and line numbers of the file.

    Returns
    -------
    Every setting within its limits; frozen.

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
    """Path of the model file; a relative path is relative to the folder of the bench file."""
    return bench_path.parent / bench.model
