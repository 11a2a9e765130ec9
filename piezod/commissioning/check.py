"""`piezod check`: everything that can be known about a bench without energising it."""

import os
import resource
import shutil
import stat
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from ipaddress import ip_address
from math import isnan
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from piezod.config import BenchConfig, load_bench, model_path
from piezod.config.link import ModbusTcpLink
from piezod.config.reference import RegisterReference, StreamReference
from piezod.control import RealTimeWarning, TableReference, check_safeguards, make_reference, real_time
from piezod.daemon.preview import missing_preview
from piezod.effects import EFFECTS
from piezod.errors import PiezodError
from piezod.model import Model, Plant, acting_effects, load_model
from piezod.recorder.segment_files import segments, size_of
from piezod.session.assembly import check_effects, check_units, check_wire, opened_link
from piezod.session.history import percentiles
from piezod.transport import ExchangeResult, Link, Reading

Level = Literal["OK", "WARN", "FAIL"]


@dataclass(frozen=True)
class Check:
    """One thing looked at."""

    name: str
    level: Level
    found: str
    remedy: str = ""


def check_bench(path: Path) -> list[Check]:
    """Look at configuration, model, link, device, clock and rights; writes nothing to the device.

    Parameters
    ----------
    path
        Bench configuration.

    Raises
    ------
    ModelError
        The model is not one from volts to newtons: nothing that follows would mean anything.
    """
    checks: list[Check] = []
    bench = _try(checks, "configuration", lambda: load_bench(path), lambda bench: f"{path}, bench '{bench.name}'")
    if bench is None:
        return checks
    _try(checks, "wire", lambda: check_wire(bench), lambda _: f"carries {bench.rate_Hz:g} Hz and every voltage")
    model = _try(
        checks, "model", lambda: load_model(model_path(bench, path)), lambda model: f"'{model.name}' has an inverse"
    )
    if model is not None:
        check_units(model, model_path(bench, path))
        checks.extend(_effects(bench, model, path))
        checks.append(_reach(bench, model))
        checks.extend(_reference(bench, model, path.parent))
    checks.extend(_file(path))
    checks.extend(_arming(bench))
    checks.extend(_network(bench))
    checks.extend(_recorder(bench))
    checks.extend(_clock())
    checks.extend(_rights(bench))
    checks.extend(_device(bench))
    return checks


Found = TypeVar("Found")


def _try(checks: list[Check], name: str, look: Callable[[], Found], say: Callable[[Found], str]) -> Found | None:
    """Append what `look` finds; returns it, or None when it raised."""
    try:
        found = look()
    except PiezodError as error:
        checks.append(Check(name, "FAIL", str(error)))
        return None
    checks.append(Check(name, "OK", say(found)))
    return found


def _effects(bench: BenchConfig, model: Model, path: Path) -> Iterator[Check]:
    """What is done about every effect of the model."""
    try:
        check_effects(bench, model, path)
    except PiezodError as error:
        yield Check("effects", "FAIL", str(error))
        return
    if bench.compensation != "inverse":
        return
    if (missing := missing_preview(bench, model)) is not None:
        yield Check("preview", "WARN", missing.words(), "send it as a file or a waveform, where it is known")
    acting = acting_effects(model)
    for handling in ("compensated", "corrected in the reading"):
        names = [
            name for name in acting if EFFECTS[name].handling == handling and name not in bench.compensation_without
        ]
        if names:
            yield Check("effects", "OK", f"{', '.join(names)}: {handling}")
    for name in bench.compensation_without:
        if name not in acting:
            yield Check(
                "effects", "WARN", f"{name}: left out, but the model has none", "compensation_without: remove it"
            )
        else:
            yield Check("effects", "WARN", f"{name}: not driven against, by compensation_without", EFFECTS[name].why)


def _reach(bench: BenchConfig, model: Model) -> Check:
    bottom, top = Plant(model).steady_range()
    found = f"{bottom:.1f} to {top:.1f} N over {model.input.low:g} to {model.input.high:g} V"
    if top > bench.limits.force_trip_N:
        return Check(
            "reach", "WARN", found, f"the full range trips at {bench.limits.force_trip_N:g} N; keep references below"
        )
    if model.input.high < bench.limits.voltage_max_V - 1e-9:
        return Check("reach", "WARN", found, "limits.voltage_max_V is above what was identified; record up to it")
    return Check("reach", "OK", found)


def _reference(bench: BenchConfig, model: Model, folder: Path) -> Iterator[Check]:
    """Only a table can be looked at before it is followed."""
    if isinstance(bench.reference, (RegisterReference, StreamReference)):
        return
    try:
        table = make_reference(bench.reference, bench.rate_Hz, folder, Reading(), counted=False)
    except PiezodError as error:
        yield Check("reference", "FAIL", str(error))
        return
    assert isinstance(table, TableReference)
    low, high = table.span()
    bottom, top = Plant(model).steady_range()
    found = f"{low:.1f} to {high:.1f} N, {len(table)} ticks"
    if low < bottom or high > top:
        remedy = f"after a reset cycle {bottom:.1f} to {top:.1f} N can be reached; beyond, the voltage is clamped"
        yield Check("reference", "WARN", found, remedy)
    else:
        yield Check("reference", "OK", found)


_UNNOTICED = {
    "identity": "another device would not be noticed",
    "map_version": "another firmware would not be noticed",
    "device_watchdog": "the output stays on when this machine dies; set the device's own by hand if it has one",
    "voltage_readback": "a wrong output would not be noticed",
    "sign_check": "a reversed sensor or stack would be noticed only at a limit",
}


def _arming(bench: BenchConfig) -> Iterator[Check]:
    """What is asked before a voltage is written, and what the configuration says that this device goes without."""
    try:
        check_safeguards(bench)
    except PiezodError as error:
        yield Check("arming", "FAIL", str(error))
    for name in bench.arming.without:
        yield Check("arming", "WARN", f"without {name}", _UNNOTICED[name])
    if not bench.arming.without:
        yield Check("arming", "OK", "needs identity, map version, watchdog, rest and a step that raises the force")


def _network(bench: BenchConfig) -> Iterator[Check]:
    """Whether the bench could be commanded by others on the way."""
    for name, link in (("link", bench.link), ("load_cell_link", bench.load_cell_link)):
        if isinstance(link, ModbusTcpLink) and link.tls is None and not _is_loopback(link.host):
            found = f"{name} is plain Modbus to {link.host}"
            yield Check(
                "network", "WARN", found, "anybody on that network can read and write; set tls, or keep it apart"
            )


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _file(path: Path) -> Iterator[Check]:
    """Whoever can write the configuration sets the limits."""
    found = path.stat()
    if found.st_mode & stat.S_IWOTH:
        yield Check("configuration", "WARN", f"{path} can be written by everybody", "chmod o-w it")
    if found.st_uid not in (0, os.getuid()):
        yield Check("configuration", "WARN", f"{path} belongs to uid {found.st_uid}", "let root or the service own it")


def _recorder(bench: BenchConfig) -> Iterator[Check]:
    """Whether ticks could be kept where they are to be kept; nothing is written."""
    config, folder = bench.recorder, bench.recordings_path
    if config is None or folder is None:
        yield Check("recorder", "OK", "off: no tick is kept; name recorder.folder to keep them")
        return
    place = folder if folder.exists() else folder.parent
    if not place.is_dir():
        yield Check(
            "recorder", "FAIL", f"recorder.folder is {folder}: {place} is no folder", "make it, or name another"
        )
    elif not os.access(place, os.W_OK | os.X_OK):
        owner = place.stat()
        found = f"recorder.folder is {folder}: {place} may not be written by uid {os.getuid()}"
        remedy = f"it belongs to uid {owner.st_uid}, gid {owner.st_gid}, mode {stat.S_IMODE(owner.st_mode):04o}"
        yield Check("recorder", "FAIL", found, remedy)
    else:
        free_MB = 1e-6 * shutil.disk_usage(place).free + 1e-6 * sum(map(size_of, segments(place, bench.name)))
        found = f"every tick into {folder}, at most {config.folder_MB:g} MB; {free_MB:.0f} MB are there for it"
        full = free_MB < config.folder_MB
        yield Check(
            "recorder", "WARN" if full else "OK", found, "lower recorder.folder_MB, or make room" if full else ""
        )


def _clock() -> Iterator[Check]:
    resolution_s = time.get_clock_info("monotonic").resolution
    source = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    name = source.read_text(encoding="ascii").strip() if source.exists() else "unknown"
    good = resolution_s <= 1e-6
    yield Check("clock", "OK" if good else "WARN", f"{name}, resolution {resolution_s * 1e9:.0f} ns")


def _rights(bench: BenchConfig) -> Iterator[Check]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with real_time(bench.real_time):
            pass
    missing = [str(warning.message) for warning in caught if issubclass(warning.category, RealTimeWarning)]
    for text in missing:
        found, _, remedy = text.partition("; ")
        yield Check("real-time rights", "WARN", found, remedy)
    if not missing:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        yield Check("real-time rights", "OK", f"all that is asked for is granted (uid {os.getuid()}, RTPRIO {limit})")


def _device(bench: BenchConfig) -> Iterator[Check]:
    try:
        with opened_link(bench) as link:
            yield Check("link", "OK", f"{link.description}, identity as configured")
            yield from _exchange(bench, link)
    except PiezodError as error:
        yield Check("link", "FAIL", str(error))


def _exchange(bench: BenchConfig, link: Link, count: int = 100) -> Iterator[Check]:
    """Poll at the tick's rate and judge time and values."""
    durations_us = np.empty(count)
    bad = 0
    for k in range(count):
        begun = time.perf_counter()
        bad += link.poll() != ExchangeResult.OK
        durations_us[k] = (time.perf_counter() - begun) * 1e6
        time.sleep(bench.dt_s)
    p99 = percentiles(durations_us)["p99"]
    found = f"{count - bad} of {count} readings good, median {np.median(durations_us):.0f} us, p99 {p99:.0f} us"
    if bad:
        causes = ", ".join(f"{r.name.lower()} {link.counts[r]}" for r in ExchangeResult if r and link.counts[r])
        yield Check("exchange", "FAIL", f"{found} ({causes})", "check cable, timeout_s and the register map")
    elif p99 > 0.5e6 * bench.dt_s:
        yield Check("exchange", "WARN", found, f"lower rate_Hz: a tick lasts {1e6 * bench.dt_s:.0f} us")
    else:
        yield Check("exchange", "OK", found)
    yield from _values(bench, link)


def _values(bench: BenchConfig, link: Link) -> Iterator[Check]:
    reading = link.reading
    limits = bench.limits
    inside = limits.force_min_N <= reading.force_N <= limits.force_trip_N
    yield Check(
        "force",
        "OK" if inside else "FAIL",
        f"{reading.force_N:.3g} N, limits {limits.force_min_N:g} to {limits.force_trip_N:g} N",
        "" if inside else "check preload, tare, scale and byte order",
    )
    if isnan(reading.voltage_readback_V):
        yield Check("voltage read-back", "WARN", "the device has none", "a wrong output cannot be noticed")
    else:
        rest = abs(reading.voltage_readback_V - limits.voltage_safe_V) <= bench.arming.readback_within_V
        yield Check(
            "voltage read-back",
            "OK" if rest else "WARN",
            f"{reading.voltage_readback_V:.3g} V",
            "" if rest else "arming needs it near the safe voltage; bring the amplifier down",
        )
    if not link.has("heartbeat"):
        yield Check("heartbeat", "WARN", "the device has none", "a frozen device is noticed only by its frozen force")
