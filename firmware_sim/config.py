"""The configuration file of the emulator: physics, firmware, connections."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from firmware_sim.errors import ConfigurationError
from firmware_sim.physics.effects import Effects, Finite, Positive, Section
from firmware_sim.physics.scenario import Scenario, load_scenario
from firmware_sim.yaml_reader import checked, read_document

UnitId = Annotated[int, Field(ge=1, le=247)]
PortNumber = Annotated[int, Field(ge=0, le=65535)]


class Firmware(Section):
    """Settings of the device: serial number, watchdog, virtual tick, faults at power-on."""

    serial_number: Annotated[int, Field(ge=0, le=65535)] = 1001
    watchdog_ms: Annotated[int, Field(ge=0, le=65535)] = 0
    watchdog_ramp_V_per_s: Positive = 400.0
    safe_V: Finite = 0.0
    virtual_tick_us: Annotated[int, Field(ge=10, le=10_000_000)] = 1000
    fault_bits: Literal[0, 8, 16, 24, 32, 40, 48, 56] = 0


class Tls(Section):
    """Modbus/TCP Security: PEM files of certificate and key of the device, and of the CA of its clients."""

    certificate: Annotated[str, Field(min_length=1)]
    key: Annotated[str, Field(min_length=1)]
    ca: Annotated[str, Field(min_length=1)]


class Tcp(Section):
    """Modbus TCP; port 0 takes a free port. With `tls`, every client needs a certificate."""

    host: str = "127.0.0.1"
    port: PortNumber = 15020
    unit_id: UnitId = 1
    one_client: bool = False
    tls: Tls | None = None


class Rtu(Section):
    """Modbus RTU on a pseudo-terminal; `link` is the path of a symbolic link to it."""

    unit_id: UnitId = 1
    link: str | None = None


class LineCommand(Section):
    """A command line with fields in braces, and its reply (null: no reply)."""

    request: Annotated[str, Field(min_length=1, max_length=200)]
    reply: Annotated[str, Field(max_length=500)] | None = None

    def pattern(self) -> re.Pattern[str]:
        """Return the pattern of a whole request; a field in braces matches a number."""
        parts = re.split(r"\{(\w+)\}", self.request)
        texts = [re.escape(part) if index % 2 == 0 else rf"(?P<{part}>\S+)" for index, part in enumerate(parts)]
        return re.compile("".join(texts))


_MEASURED = "{force_N:.4f},{voltage_V:.4f},{heartbeat},{command_echo},{status},{temperature_C:.3f}"


class Line(Section):
    """The ASCII line protocol on a pseudo-terminal, on TCP, or on both."""

    pty: bool = True
    link: str | None = None
    host: str = "127.0.0.1"
    tcp_port: PortNumber | None = None
    terminator: Annotated[str, Field(min_length=1, max_length=4)] = "\n"
    set_voltage: LineCommand = LineCommand(request="SVA A {voltage_V}")
    measure: LineCommand = LineCommand(request="MEAS?", reply=_MEASURED)
    identify: LineCommand = LineCommand(request="IDN?", reply="PIEZO-BENCH,{identity},{serial_number},{map_version}")
    set_watchdog: LineCommand = LineCommand(request="WDT {watchdog_ms}")
    ask_watchdog: LineCommand = LineCommand(request="WDT?", reply="{watchdog_ms}")


class EmulatorConfig(Section):
    """One emulated bench and its connections."""

    schema_: Annotated[Literal["firmware_sim.emulator/1"], Field(alias="schema")]
    scenario: str = "stack"
    effects: Effects = Effects()
    physics: Annotated[dict[str, Any], Field(default_factory=dict)]
    seed: Annotated[int, Field(ge=0)] | None = None
    time: Literal["real", "virtual"] = "real"
    firmware: Firmware = Firmware()
    tcp: Tcp | None = Tcp()
    rtu: Rtu | None = None
    line: Line | None = None

    @field_validator("effects", mode="before")
    @classmethod
    def _switched(cls, effects: object) -> object:
        """Replace `creep: true` by creep at its default strength, and `false` by off."""
        if not isinstance(effects, dict):
            return effects
        plain: dict[bool, dict[str, object] | None] = {True: {}, False: None}
        return {name: plain[value] if isinstance(value, bool) else value for name, value in effects.items()}

    @model_validator(mode="after")
    def _scenario_exists(self) -> Self:
        if "effects" in self.physics:
            raise ValueError(
                "physics.effects: not allowed here; put effects into the section `effects`, beside physics"
            )
        try:
            configured_scenario(self)
        except ConfigurationError as error:
            raise ValueError(str(error)) from None
        return self


def load_config(path: Path) -> EmulatorConfig:
    """Read the configuration of the emulator.

    Raises
    ------
    ConfigurationError
        One line with file, line, key, value and limit.
    """
    return checked(EmulatorConfig, read_document(path))


def configured_scenario(config: EmulatorConfig) -> Scenario:
    """Return the scenario of a configuration, with its overrides and effects.

    Raises
    ------
    ConfigurationError
        The scenario does not exist, or a value is invalid.
    """
    effects = config.effects.model_dump(exclude_none=True)
    return load_scenario(config.scenario, {**config.physics, **({"effects": effects} if effects else {})})
