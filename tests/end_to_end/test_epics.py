"""The records of a bench in a real IOC, read and commanded by a Channel Access client."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.benches.daemon import LONG_LIMITS, WITHIN_S, daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.processes import Popen

pytestmark = pytest.mark.xdist_group("epics")
IOC = Path(__file__).parents[2] / "config" / "piezod_ioc.py"
LOOPBACK = {"EPICS_CA_ADDR_LIST": "127.0.0.1", "EPICS_CA_AUTO_ADDR_LIST": "NO", "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1"}
CLIENT = """
import asyncio, json, sys
from aioca import caget, caput
async def main():
    if len(sys.argv) > 2:
        await caput(sys.argv[1], 1, wait=True, timeout=10)
    else:
        value = await caget(sys.argv[1], timeout=10)
        print(json.dumps(value if isinstance(value, str) else float(value)))
asyncio.run(main())
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    pytest.importorskip("softioc")
    pytest.importorskip("aioca")
    with emulator("--port", "0") as served:
        arming = {"voltage_V_per_s": 800.0, "reset_cycle": False}
        folder = tmp_path_factory.mktemp("epics")
        path = bench_file(
            folder, served, rate_Hz=100, limits=LONG_LIMITS, arming=arming, reference={"frequency_Hz": 0.5}
        )
        with daemon(path):
            yield path


@pytest.fixture(scope="module")
def prefix(bench):
    name = f"PIEZOD-{os.getpid()}"
    ioc = Popen([sys.executable, str(IOC), str(bench), name], env=os.environ | LOOPBACK, stdout=subprocess.DEVNULL)
    yield name
    ioc.terminate()
    ioc.wait(timeout=WITHIN_S)


def channel(name, *more):
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, name, *more],
        env=os.environ | LOOPBACK,
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        check=True,
    )
    return json.loads(done.stdout) if done.stdout else None


def until(condition):
    deadline_s = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.2)


def state_of(bench):
    return json.loads(piezod("status", bench, "--json").stdout)["state"]


def test_the_records_show_the_bench_and_a_write_arms_and_stops_it(bench, prefix):
    until(lambda: channel(f"{prefix}:STATE") == "DISARMED")
    channel(f"{prefix}:ARM", "write")
    until(lambda: channel(f"{prefix}:STATE") == "RUNNING")
    forces_N = set()
    for _ in range(4):
        forces_N.add(channel(f"{prefix}:FORCE"))
        time.sleep(0.6)
    assert len(forces_N) > 1  # it follows a sine
    assert all(10.0 < force_N < 290.0 for force_N in forces_N)
    assert channel(f"{prefix}:VOLTAGE") > 5.0
    channel(f"{prefix}:STOP", "write")
    until(lambda: state_of(bench) == "DISARMED")
