"""`piezod support-bundle`: a ZIP file with the data that a remote engineer needs, without secrets.

- bundle.json: versions, machine, model, missing parts with reasons
- bench.yaml: effective configuration, with secrets replaced
- status.json: status of the daemon, with the bytes of the last failed exchange with the device
- log.txt: last lines of its log
- ticks.csv: last ticks of the ring log
- transitions.txt: changes of state and cause among these ticks
"""

import contextlib
import importlib.metadata
import io
import json
import os
import platform
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from piezod import __version__
from piezod.config import BenchConfig, load_bench, model_path, read_document
from piezod.config.host_name import address_of
from piezod.config.keys import all_values, effective_text
from piezod.control import CAUSE_TEXT, ROW_DTYPE, Cause, RingReader, State
from piezod.daemon.client import Client
from piezod.errors import PiezodError
from piezod.model import file_sha256, load_model
from piezod.recording.targets import check_absent, check_page
from piezod.runtime.files import written

REMOVED = "REMOVED"
LAST_TICKS = 20_000
SHORTEST_SECRET = 4  # length of the shortest secret that is replaced outside the configuration [characters]
PACKAGES = ("numpy", "numba", "pyserial", "pymodbus", "PyYAML", "pydantic", "prometheus-client", "scipy", "bokeh")


def write_bundle(config: Path, output: Path, *, force: bool = False) -> dict[str, Any]:
    """Collect the parts and write them into one ZIP file.

    Parameters
    ----------
    config
        Bench configuration; the daemon need not run.
    force
        Whether to replace an existing file.

    Returns
    -------
    dict
        Content of `bundle.json`.

    Raises
    ------
    UsageError
        The file exists, and `force` is not set.
    ConfigurationError
        The configuration is invalid, or the file cannot be written.
    """
    check_absent(output, force=force)
    check_page(output)
    bench = load_bench(config)
    missing: dict[str, str] = {}
    parts: dict[str, Any] = {}
    makers = {"status.json": _status, "log.txt": _log, "ticks.csv": _ticks, "transitions.txt": _transitions}
    for name, make in makers.items():
        try:
            parts[name] = make(bench)
        except PiezodError as error:
            missing[name] = str(error)
    about = {
        "schema": "piezod.support/1",
        "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "versions": _versions(),
        "machine": _machine(),
        "model": _model(bench, config),
        "left_out": missing,
    }
    parts["bundle.json"] = about
    content, secrets = io.BytesIO(), _secrets(bench)
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as bundle:
        shown = effective_text(_redacted(all_values(bench), secrets), read_document(config).content)
        bundle.writestr("bench.yaml", shown)
        for name, part in parts.items():
            shown = _redacted(part, secrets)  # before it is encoded, which writes a quote in another way
            bundle.writestr(name, shown if isinstance(shown, str) else json.dumps(shown, indent=2) + "\n")
    written(output, content.getvalue(), mode=0o600)
    return about


def _secrets(bench: BenchConfig) -> set[str]:
    """Texts that must not appear in the bundle."""
    secrets: set[str] = set()
    for name in ("link", "load_cell_link"):
        link = all_values(bench)[name]
        if link is None:
            continue
        secrets |= {value for value in (link.get("tls") or {}).values() if value}
        secrets |= {command["send"] for command in _commands(link)}
        secrets |= {command["reply"] for command in _commands(link) if command["reply"]}
        if (host := link.get("host")) and not _private(host):
            secrets.add(host)
    return secrets | {value for value in (bench.daemon.socket_group,) if value}


def _commands(link: dict[str, Any]) -> list[dict[str, Any]]:
    """Commands of an ASCII protocol, as dictionaries with `send` and `reply`."""
    single = (link.get(name) for name in ("set_voltage", "measure", "identity", "watchdog"))
    return [command for command in (*single, *link.get("setup", ())) if command]


def _private(host: str) -> bool:
    address = address_of(host)
    return host == "localhost" if address is None else not address.is_global


def _redacted(value: object, secrets: set[str]) -> Any:  # noqa: ANN401  # any value of JSON
    """Copy of a value without secrets, without the folder of the user, and without the location of the bench.

    Replaced: file names and host names of TLS, host names, public addresses, groups, and the lines of an ASCII
    protocol, which may contain a password. Numbers, registers and private addresses stay, because support needs them.
    A secret within a text is replaced in each form that a message gives it (`_forms`). A short one is replaced only as
    a whole value: it could be part of a word.
    """
    if isinstance(value, dict):
        return {key: _redacted(part, secrets) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_redacted(part, secrets) for part in value]
    if not isinstance(value, str) or value in secrets:
        return REMOVED if isinstance(value, str) else value
    forms = {form for secret in secrets for form in _forms(secret) if len(form) >= SHORTEST_SECRET}
    for form in sorted(forms, key=len, reverse=True):
        value = value.replace(form, REMOVED)
    return value.replace(str(Path.home()), "~")


def _forms(secret: str) -> set[str]:
    """A secret as it stands in a text: as it is, quoted by Python or JSON, and with marks for what is not printable."""
    text = secret.strip()
    quoted = (repr(text)[1:-1], ascii(text)[1:-1], repr(text.encode())[2:-1])
    as_json = (json.dumps(text)[1:-1], json.dumps(text, ensure_ascii=False)[1:-1])
    return {text, *quoted, *as_json, "".join(c if c.isprintable() else "?" for c in text)}


def _status(bench: BenchConfig) -> dict[str, Any]:
    client = Client(bench.socket_path)
    try:
        status: dict[str, Any] = client.ask("status")
    finally:
        client.close()
    if exchange := status.get("bad_exchange"):
        status["bad_exchange"] = without_lines(exchange, bench)
    return status


def without_lines(exchange: dict[str, Any], bench: BenchConfig) -> dict[str, Any]:
    """A failed exchange without the bytes of an ASCII protocol, which may contain a password.

    Parameters
    ----------
    exchange
        Failed exchange, as `read_bad_exchange` returns it. Frames of Modbus stay, because support needs them.
    """
    link = all_values(bench)[exchange["link"]]
    if not _commands(link):
        return exchange
    reply = bytes.fromhex(exchange["reply"]).decode("latin-1")
    repeats = any(secret.strip() in reply for secret in _secrets(bench) if len(secret.strip()) >= SHORTEST_SECRET)
    return exchange | {"request": REMOVED} | ({"reply": REMOVED} if repeats else {})


def _log(bench: BenchConfig) -> str:
    client = Client(bench.socket_path)
    try:
        return "".join(f"{line}\n" for line in client.ask("log")["lines"])
    finally:
        client.close()


def _rows(bench: BenchConfig) -> np.ndarray:
    reader = RingReader(bench.ring_log_path)
    reader.seek(max(0, reader.waiting - LAST_TICKS))
    return reader.read()


def _ticks(bench: BenchConfig) -> str:
    rows, lines = _rows(bench), io.StringIO()
    lines.write(",".join(ROW_DTYPE.names or ()) + "\n")
    for row in rows.tolist():
        lines.write(",".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in row) + "\n")
    return lines.getvalue()


def _transitions(bench: BenchConfig) -> str:
    rows = _rows(bench)
    changed = np.flatnonzero(np.diff(rows["state"]) | np.diff(rows["cause"])) + 1
    return "".join(
        f"tick {row['tick']}: {State(row['state']).name}, {CAUSE_TEXT[Cause(row['cause'])]}\n"
        for row in rows[[0, *changed] if rows.size else []]
    )


def _versions() -> dict[str, str]:
    versions = {"piezod": __version__, "python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def _machine() -> dict[str, Any]:
    """Properties of the machine that determine the lateness of ticks, without names and addresses."""
    return {
        "system": f"{platform.system()} {platform.release()}",
        "kernel": platform.version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load": [round(load, 2) for load in os.getloadavg()],
        "real_time_kernel": Path("/sys/kernel/realtime").exists(),
        "interpreter": sys.implementation.name,
    }


def _model(bench: BenchConfig, config: Path) -> dict[str, Any]:
    path = model_path(bench, config)
    try:
        model = load_model(path)
        return {
            "sha256": file_sha256(path),
            "name": model.name,
            "plays": len(model.hysteresis.plays.weights),
            "dead_zones": len(model.hysteresis.dead_zones.weights),
            "effects": [effect.name for effect in model.effects],
        }
    except (PiezodError, OSError) as error:
        return {"problem": str(error)}
