"""Fuzzing of files: bench configurations, models, recordings."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel

from piezod.commissioning.shipped_files import shipped
from piezod.config import BenchConfig, load_bench
from piezod.effects import EFFECTS
from piezod.errors import PiezodError
from piezod.model import load_model
from piezod.recording import Recording, open_stream, read_recording, write_recording
from piezod.session.assembly import check_wire
from piezod.transport import make_link
from tests.fuzz.mutation import mutate_yaml
from tests.fuzz.target import Check, Target, peak_resident_KiB
from tests.unit.transport.scripted import LINE

SHARED = "/dev/shm"
MOST_MIB = 400
"""Largest growth of the peak resident memory by reading one small file [MiB]."""

SUFFIXES = (".csv", ".h5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite")
BENCHES = ("bench.yaml", "wago_750.yaml", "labjack_t7.yaml", "thorlabs_mdt693b.yaml")


NOT_NEEDED = ("map_version", "order_check", "virtual_time", "virtual_tick_us")


def bench_seeds() -> list[bytes]:
    """Bench files for every link, without comments."""
    contents = [_short(yaml.safe_load(shipped(name).read_text(encoding="utf-8"))) for name in BENCHES]
    contents[0]["link"]["registers"] = {
        role: entry for role, entry in contents[0]["link"]["registers"].items() if role not in NOT_NEEDED
    }
    contents.append(_with_link(contents[0], {"kind": "modbus_rtu", "port": "/dev/ttyUSB0", "baudrate": 921600}))
    line = {key: value for key, value in LINE.items() if key != "setup"}
    contents.append(_with_link(contents[0], {"kind": "serial_line", "port": "/dev/ttyUSB0", "baudrate": 921600} | line))
    for reference in (
        {"kind": "file", "path": "reference.csv"},
        {"kind": "register"},
        {"kind": "stream", "listen": "udp://127.0.0.1:5000"},
    ):
        contents.append(contents[0] | {"reference": reference})
    return [yaml.safe_dump(content, sort_keys=False).encode() for content in contents]


def _short(content: dict[str, Any]) -> dict[str, Any]:
    """Remove optional keys, since PyYAML takes most of the time."""
    return {
        key: {name: one for name, one in value.items() if one is not None} if isinstance(value, dict) else value
        for key, value in content.items()
        if key not in ("real_time", "daemon")
    }


def _with_link(content: dict[str, Any], link: dict[str, Any]) -> dict[str, Any]:
    """The bench with another link, without the keys that this link does not have."""
    registers = {} if link["kind"] == "serial_line" else {"registers": content["link"]["registers"]}
    limits = content["limits"] | {"temperature_trip_degC": None, "device_watchdog_ms": 100}
    return content | {"link": link | registers, "limits": limits, "rate_Hz": 200}


def bench_check() -> Check:
    """Load a bench as the daemon does, make its link, and check the accepted values."""

    def check(path: Path) -> None:
        bench = load_bench(path)
        finite(bench)
        consistent(bench)
        try:
            check_wire(bench)
            make_link(bench.link, bench.load_cell_link).close()
        except PiezodError as error:  # the error names the key; the command adds the file
            raise type(error)(f"{path}: {error}") from error.__cause__

    return from_file(".yaml", check)


def consistent(bench: BenchConfig) -> None:
    """Check the conditions of an accepted bench independently."""
    limits, tick_ms = bench.limits, 1e3 / bench.rate_Hz
    held = {
        "voltage range": limits.voltage_min_V < limits.voltage_max_V,
        "force range": limits.force_min_N < limits.force_trip_N,
        "slew within the amplifier's current": limits.slew_V_per_s
        <= 1.000001 * limits.current_max_A / limits.capacitance_F,
        "watchdog above two ticks": not limits.device_watchdog_ms or limits.device_watchdog_ms > 2 * tick_ms,
        "watchdog below the loss of communication": limits.device_watchdog_ms < limits.comm_loss_ms,
        "arming within the slew": bench.arming.voltage_V_per_s <= limits.slew_V_per_s,
    }
    if broken := [what for what, good in held.items() if not good]:
        raise AssertionError(f"a bench was accepted without {', '.join(broken)}")


def model_seeds() -> list[bytes]:
    """The shipped model with fewer operators, without and with an effect and initial states."""
    content = yaml.safe_load(shipped("model.yaml").read_text(encoding="utf-8"))
    for kind, count in (("plays", 5), ("dead_zones", 3)):
        operators = content["hysteresis"][kind]
        content["hysteresis"][kind] = {key: values[:count] for key, values in operators.items()}
    values = {one.name: 0.5 * (one.low + one.high) for one in EFFECTS["creep"].parameters}
    creep = content | {"effects": [{"name": "creep", "parameters": values}], "sampling": "held"}
    states = content | {"start": {"kind": "states", "states": [0.0] * 5}}
    reset = content | {"start": {"kind": "reset", "peak": 100.0}}
    return [yaml.safe_dump(one, sort_keys=False).encode() for one in (content, creep, states, reset)]


def model_check() -> Check:
    """Load a model and evaluate its operator once."""

    def check(path: Path) -> None:
        model = load_model(path)
        finite(model)
        operator = model.operator()
        operator.run(np.linspace(0.0, 100.0, 50))

    return from_file(".yaml", check)


def finite(value: object) -> None:
    """Check that every number of an accepted file is finite."""
    if isinstance(value, float) and not isfinite(value):
        raise AssertionError("a number that is not finite was accepted")
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            finite(getattr(value, name))
    elif is_dataclass(value):
        for one in fields(value):
            finite(getattr(value, one.name))
    elif isinstance(value, tuple | list):
        for one in value:
            finite(one)
    elif isinstance(value, dict):
        for one in value.values():
            finite(one)


def recording_seeds(suffix: str) -> list[bytes]:
    """Recordings as the project writes them: several samples, one sample, and missing samples."""
    rng = np.random.default_rng(1)
    seeds = []
    with tempfile.TemporaryDirectory(dir=SHARED) as folder:
        for samples in (1, 12, 60):
            channels = {"voltage_V": rng.normal(size=samples), "force_N": rng.normal(size=samples)}
            if samples == 12:
                channels["force_N"][3] = np.nan
            path = Path(folder) / f"rec{suffix}"
            write_recording(Recording(np.arange(samples) * 1e-3, channels, {"bench": "a & <b>"}), path)
            seeds.append(path.read_bytes())
    return seeds


def recording_check(suffix: str) -> Callable[[], Check]:
    """Read a recording at once and in pieces, and compare the results."""

    def check(path: Path) -> None:
        recording = read_recording(path)
        pieces = list(open_stream(path, chunk=16))
        together = np.concatenate([piece.time_s for piece in pieces]) if pieces else np.empty(0)
        if not np.array_equal(recording.time_s, together):
            raise AssertionError(f"{recording.time_s.size} samples read at once, {together.size} in pieces")
        if not (np.isfinite(recording.time_s).all() and (np.diff(recording.time_s) > 0).all()):
            raise AssertionError("time that does not increase was accepted")
        for values in recording.channels.values():
            if values.dtype != np.float64 or values.shape != recording.time_s.shape:
                raise AssertionError(f"a channel of {values.dtype} and shape {values.shape} was accepted")

    return lambda: from_file(suffix, check)


def from_file(suffix: str, check: Callable[[Path], None]) -> Check:
    """Check an input as a file; a refusal must begin with its name, and memory must not grow."""
    path = Path(tempfile.mkdtemp(dir=SHARED, prefix="piezod-fuzz-")) / f"f{suffix}"

    def written(data: bytes) -> None:
        path.write_bytes(data)
        before_KiB = peak_resident_KiB()
        try:
            check(path)
        except PiezodError as error:
            if not str(error).startswith(f"{path}:"):
                raise AssertionError(f"a refusal does not begin with the file: {error}") from error
            raise
        finally:
            grown_MiB = (peak_resident_KiB() - before_KiB) / 1024
            if grown_MiB > MOST_MIB:
                raise AssertionError(f"{len(data)} bytes took {grown_MiB:.0f} MiB")
            if extra := sorted({one.name for one in path.parent.iterdir()} - {path.name}):
                raise AssertionError(f"left behind: {extra}")

    weakref.finalize(written, shutil.rmtree, path.parent)
    return written


TARGETS = [
    Target("bench", "configurations", bench_seeds, bench_check, mutate_yaml),
    Target("model", "models", model_seeds, model_check, mutate_yaml),
    *(
        Target(suffix[1:], "recordings", lambda suffix=suffix: recording_seeds(suffix), recording_check(suffix))
        for suffix in SUFFIXES
    ),
]
