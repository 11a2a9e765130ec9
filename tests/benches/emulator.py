"""The emulated bench as hardware: a process of its own, and bench files that point at it."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path

import yaml

from tests.benches.processes import Popen, run

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "config" / "bench.yaml"
PATIENT_S = 0.5  # a virtual machine may stand still for a tenth of a second
EMULATOR = ROOT / "config" / "emulator.yaml"


@contextlib.contextmanager
def emulator(*arguments, config=EMULATOR):
    """Start it, yield what it serves, end it by its id."""
    process = Popen(
        [sys.executable, "-m", "firmware_sim", str(config), "--until-stdin-closes", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        line = process.stdout.readline()
        assert line, f"the emulator ended with {process.wait()}"
        yield json.loads(line)
    finally:
        process.stdin.close()  # which ends it; a signal on top could meet it while it is ending
        code = process.wait(timeout=60)
        process.stdout.close()
        assert code == 0


def bench_file(folder, serves, **changes):
    """Write a bench file for what the emulator serves; `changes` replace whole sections or keys at the top."""
    content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
    registers = content["link"]["registers"]
    if "rtu" in serves:
        content["link"] = {"kind": "modbus_rtu", "port": serves["rtu"], "baudrate": 921600, "timeout_s": PATIENT_S}
    elif "line" in serves:
        content["link"] = line_link(serves["line"])
    else:
        host, _, port = serves["tcp"].rpartition(":")
        content["link"] |= {"host": host, "port": int(port), "timeout_s": PATIENT_S}
    if "line" not in serves:
        content["link"]["registers"] = registers
    content["model"] = str(ROOT / "config" / "model.yaml")
    content["daemon"] = {"ring_log": str(folder / "ring"), "ring_seconds": 60}
    content["real_time"] = {"fifo_priority": 0, "lock_memory": False, "hold_cpu_latency": False}
    for key, value in changes.items():
        merged = isinstance(value, dict) and "kind" not in value and content.get(key) is not None
        content[key] = content[key] | value if merged else value
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def line_link(port):
    """The emulator's ASCII protocol."""
    number = r"[-+0-9.eE]+"
    return {
        "kind": "serial_line",
        "port": port,
        "baudrate": 921600,
        "timeout_s": PATIENT_S,
        "identity": {"send": "IDN?", "reply": "PIEZO-BENCH,20570,1001,1"},
        "watchdog": {"send": "WDT {watchdog_ms:.0f}"},
        "set_voltage": {"send": "SVA A {voltage_V:.4f}"},
        "measure": {
            "send": "MEAS?",
            "reply": rf"(?P<force_N>{number}),(?P<voltage_readback_V>{number}),(?P<heartbeat>\d+),\d+,"
            rf"(?P<status>\d+),(?P<temperature_C>{number})",
        },
    }


def piezod(*arguments, timeout=120):
    """Run a command as a user would."""
    return run([sys.executable, "-m", "piezod", *map(str, arguments)], timeout=timeout)
