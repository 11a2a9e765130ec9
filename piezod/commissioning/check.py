"""`piezod check`: check a bench without energising it.

This module checks the configuration and its model; `check_reference.py` the reference, `check_machine.py` this machine,
and `check_device.py` the device.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from piezod.commissioning.check_device import check_device
from piezod.commissioning.check_machine import check_configuration_file, check_machine
from piezod.commissioning.check_reference import check_distances, check_reference
from piezod.commissioning.check_result import Check
from piezod.config import BenchConfig, load_bench, model_path
from piezod.config.host_name import address_of
from piezod.config.link import ModbusTcpLink, RtuOverTcpLink
from piezod.control import check_safeguards
from piezod.daemon.preview import missing_preview
from piezod.effects import EFFECTS
from piezod.errors import PiezodError
from piezod.model import ExtendedCompensator, Model, acting_effects, load_model, steady_range
from piezod.model.unnamed_law import NAME as UNNAMED
from piezod.session.assembly import check_effects, check_units, check_wire
from piezod.transport.port_names import is_allowed_in_service

WITHOUT_CONSEQUENCES = {
    "identity": "another device would not be noticed",
    "map_version": "another firmware would not be noticed",
    "device_watchdog": "the output stays on when this machine dies; set the device's own by hand if it has one",
    "voltage_readback": "a wrong output would not be noticed",
    "sign_check": "a reversed sensor or stack would be noticed only at a limit",
}
"""Consequences of a precondition that `arming.without` leaves out."""

Result = TypeVar("Result")


def check_bench(path: Path) -> list[Check]:
    """Check configuration, model, machine and device; nothing is written to the device.

    Raises
    ------
    ModelError
        The model is not one from volts to newtons, so that the other checks have no meaning.
    """
    checks: list[Check] = []
    bench = _attempt(checks, "configuration", lambda: load_bench(path), lambda bench: f"{path}, bench '{bench.name}'")
    if bench is None:
        return checks
    _attempt(checks, "wire", lambda: check_wire(bench), lambda _: f"carries {bench.rate_Hz:g} Hz and every voltage")
    model = _attempt(
        checks, "model", lambda: load_model(model_path(bench, path)), lambda model: f"'{model.name}' has an inverse"
    )
    if model is not None:
        check_units(model, model_path(bench, path))
        checks.extend(check_model_effects(bench, model, path))
        checks.append(_force_range(bench, model))
        checks.extend(check_distances(bench, model))
        checks.extend(check_reference(bench, model, path.parent))
    checks.extend(check_configuration_file(path))
    for part in (_arming, _network, check_ports, check_machine, check_device):
        checks.extend(part(bench))
    return checks


def _attempt(
    checks: list[Check], name: str, action: Callable[[], Result], describe: Callable[[Result], str]
) -> Result | None:
    """Run an action, append its result or its error to the checks, and return the result; None after an error."""
    try:
        result = action()
    except PiezodError as error:
        checks.append(Check(name, "FAIL", str(error)))
        return None
    checks.append(Check(name, "OK", describe(result)))
    return result


def check_model_effects(bench: BenchConfig, model: Model, path: Path) -> Iterator[Check]:
    """Check how each effect of the model is handled."""
    try:
        check_effects(bench, model, path)
    except PiezodError as error:
        yield Check("effects", "FAIL", str(error))
        return
    if bench.compensation != "inverse":
        return
    if (missing := missing_preview(bench, model)) is not None:
        yield Check("preview", "WARN", missing.message(), "send it as a file or a waveform, where it is known")
    acting = acting_effects(model)
    for handling in ("compensated", "corrected in the reading"):
        names = [
            name for name in acting if EFFECTS[name].handling == handling and name not in bench.compensation_without
        ]
        if names:
            yield Check("effects", "OK", f"{', '.join(names)}: {handling}")
    if model.unnamed_law is not None:
        yield _law_check(bench, model)
    for name in bench.compensation_without:
        if name == UNNAMED and model.unnamed_law is not None:
            continue
        if name not in acting:
            yield Check(
                "effects", "WARN", f"{name}: left out, but the model has none", "compensation_without: remove it"
            )
        else:
            finding = f"{name}: not compensated, because of compensation_without"
            yield Check("effects", "WARN", finding, EFFECTS[name].why)


def _law_check(bench: BenchConfig, model: Model) -> Check:
    """Check whether the unnamed law is compensated."""
    if UNNAMED in bench.compensation_without:
        return Check("effects", "WARN", "unnamed law: not compensated, because of compensation_without")
    if ExtendedCompensator(model, bench.dt_s, bench.compensation_without).compensates_law:
        return Check("effects", "OK", "unnamed law: compensated")
    assert model.unnamed_law is not None
    why = "it has modes" if model.unnamed_law.modes else "it changes more within a tick than the force"
    finding = f"unnamed law: not compensated, {why}"
    return Check("effects", "WARN", finding, f"compensation_without: [{UNNAMED}] says that this is known")


def _force_range(bench: BenchConfig, model: Model) -> Check:
    """Check the force range of the model against the limits."""
    bottom, top = steady_range(model)
    finding = f"{bottom:.1f} to {top:.1f} N over {model.input.low:g} to {model.input.high:g} V"
    if top > bench.limits.force_trip_N:
        return Check(
            "reach", "WARN", finding, f"the full range trips at {bench.limits.force_trip_N:g} N; keep references below"
        )
    if model.input.high < bench.limits.voltage_max_V - 1e-9:
        return Check("reach", "WARN", finding, "limits.voltage_max_V is above what was identified; record up to it")
    return Check("reach", "OK", finding)


def _arming(bench: BenchConfig) -> Iterator[Check]:
    """Check the preconditions of arming: support of the link, and preconditions that the bench file waives."""
    try:
        check_safeguards(bench)
    except PiezodError as error:
        yield Check("arming", "FAIL", str(error))
    for name in bench.arming.without:
        yield Check("arming", "WARN", f"without {name}", WITHOUT_CONSEQUENCES[name])
    if not bench.arming.without:
        yield Check("arming", "OK", "needs identity, map version, watchdog, rest and a step that raises the force")


def _network(bench: BenchConfig) -> Iterator[Check]:
    """Check whether other programs on the network can command the bench."""
    for name, link in (("link", bench.link), ("load_cell_link", bench.load_cell_link)):
        if isinstance(link, ModbusTcpLink | RtuOverTcpLink) and link.tls is None and not _is_loopback(link.host):
            finding = f"{name} is Modbus without TLS to {link.host}"
            tls = "set tls, or " if isinstance(link, ModbusTcpLink) else ""
            remedy = f"every program on that network can read and write; {tls}use a separate network"
            yield Check("network", "WARN", finding, remedy)


def check_ports(bench: BenchConfig) -> Iterator[Check]:
    """Check whether the service may open the serial ports; by hand a user may open others."""
    for name, link in (("link", bench.link), ("load_cell_link", bench.load_cell_link)):
        port = getattr(link, "port", None)
        if isinstance(port, str) and not is_allowed_in_service(port):
            finding = f"{name}.port is {port}, which piezod.service does not allow"
            remedy = f"systemctl edit piezod.service, and add: [Service] DeviceAllow={os.path.realpath(port)} rw"
            yield Check("service", "WARN", finding, remedy)


def _is_loopback(host: str) -> bool:
    address = address_of(host)
    return host == "localhost" if address is None else address.is_loopback
