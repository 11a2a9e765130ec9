"""The bridges against real peers: mosquitto, and an OPC UA client."""

import asyncio
import contextlib
import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from piezod.bridge.values import Newest
from piezod.control import ROW_DTYPE, RingLog
from piezod.transport import ExchangeResult
from tests.benches.certificates import openssl
from tests.benches.daemon import LONG_LIMITS, WITHIN_S, daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.processes import Popen

pytestmark = pytest.mark.xdist_group("bridge")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with emulator("--port", "0") as served:
        folder = tmp_path_factory.mktemp("bridge")
        path = bench_file(
            folder,
            served,
            rate_Hz=100,
            limits=LONG_LIMITS,
            arming={"voltage_V_per_s": 800.0, "reset_cycle": False},
            reference={"frequency_Hz": 0.5},
        )
        with daemon(path):
            yield path


@contextlib.contextmanager
def bridge(bench, *options):
    process = Popen(
        [sys.executable, "-m", "piezod", "bridge", str(bench), *map(str, options)], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process, process.stdout.readline()
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=WITHIN_S)
        process.stdout.close()


@pytest.fixture(scope="module")
def broker():
    path = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
    if path is None:
        pytest.skip("no mosquitto here: apt-get install mosquitto")
    port = free_port()
    process = Popen([path, "-p", str(port)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    deadline_s = time.monotonic() + WITHIN_S
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            break
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    yield port
    process.kill()
    process.wait()


class Subscriber:
    """Every message of a broker, by topic."""

    def __init__(self, port):
        aiomqtt = pytest.importorskip("aiomqtt")
        self.client, self.seen = aiomqtt.Client("127.0.0.1", port), {}

    async def until(self, condition):
        async def listen():
            async for message in self.client.messages:
                self.seen.setdefault(str(message.topic), []).append(message.payload)
                if condition(self.seen):
                    return

        await asyncio.wait_for(listen(), WITHIN_S)


def test_a_broker_gets_ticks_and_status_and_learns_of_the_end_of_a_killed_bridge(bench, broker):
    async def run():
        subscriber = Subscriber(broker)
        async with subscriber.client as client:
            await client.subscribe("piezod/#")
            with bridge(bench, "--mqtt", f"mqtt://127.0.0.1:{broker}") as (process, line):
                assert line.startswith(f"mqtt: 127.0.0.1:{broker}, topics piezod/")
                await subscriber.until(
                    lambda seen: (
                        sum(len(v) for k, v in seen.items() if k.endswith("tick")) >= 5
                        and any(k.endswith("status") for k in seen)
                    )
                )
                process.kill()
                await subscriber.until(lambda seen: any(v[-1] == b"0" for k, v in seen.items() if k.endswith("online")))
        return subscriber.seen

    seen = asyncio.run(run())
    by_name = {topic.rpartition("/")[2]: payloads for topic, payloads in seen.items()}
    assert by_name["online"] == [b"1", b"0"]
    ticks = [json.loads(one) for one in by_name["tick"]]
    assert all(after["tick"] > before["tick"] for before, after in itertools.pairwise(ticks))
    assert ticks[0]["state"] == "DISARMED"
    assert abs(ticks[-1]["time_s"] - time.time()) < 60.0
    assert isinstance(ticks[0]["force_N"], float)
    assert json.loads(by_name["status"][0])["state"] == "DISARMED"


def test_a_broker_that_comes_later_is_found(bench):
    path = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
    if path is None:
        pytest.skip("no mosquitto here: apt-get install mosquitto")
    port = free_port()
    with bridge(bench, "--mqtt", f"mqtt://127.0.0.1:{port}") as (process, line):
        assert "trying again" in line
        late = Popen([path, "-p", str(port)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            assert process.stdout.readline().startswith("mqtt: 127.0.0.1")
        finally:
            late.kill()
            late.wait()


def test_a_bridge_ends_when_its_broker_dies_in_the_same_moment(bench):
    path = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
    if path is None:
        pytest.skip("no mosquitto here: apt-get install mosquitto")
    for _ in range(3):
        port = free_port()
        dying = Popen([path, "-p", str(port)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        with bridge(bench, "--mqtt", f"mqtt://127.0.0.1:{port}") as (process, first):
            connected = process.stdout.readline() if "trying again" in first else first  # it may be there later
            assert connected.startswith("mqtt: 127.0.0.1")
            dying.kill()
            process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=10.0) == 0
        dying.wait()


def test_a_client_reads_nodes_that_it_cannot_write_and_finds_no_methods(bench):
    asyncua = pytest.importorskip("asyncua")
    port = free_port()

    async def run():
        async with asyncua.Client(f"opc.tcp://127.0.0.1:{port}/piezod/") as client:
            index = await client.get_namespace_index("urn:piezod")
            (folder,) = [one for one in await client.nodes.objects.get_children() if one.nodeid.NamespaceIndex == index]
            force = await folder.get_child(f"{index}:force_N")
            before, state = await force.read_value(), await (await folder.get_child(f"{index}:state")).read_value()
            ticks = []
            for _ in range(2):
                ticks.append(await (await folder.get_child(f"{index}:tick")).read_value())
                await asyncio.sleep(0.5)
            with pytest.raises(asyncua.ua.uaerrors.BadUserAccessDenied):
                await force.write_value(before + 1.0)
            return state, ticks, await folder.get_methods()

    with bridge(bench, "--opcua", port) as (_, line):
        assert line.startswith(f"opc ua: opc.tcp://127.0.0.1:{port}/piezod/  (read only)")
        state, ticks, methods = asyncio.run(run())
    assert state == "DISARMED"
    assert ticks[1] > ticks[0]
    assert methods == []


@pytest.mark.parametrize("how", ["killed", "standing", "without a device"])
def test_values_of_a_daemon_that_is_killed_or_stands_or_has_lost_its_device_are_bad(tmp_path, how):
    asyncua = pytest.importorskip("asyncua")
    port = free_port()

    async def good(force):
        return (await force.read_data_value(raise_on_bad_status=False)).StatusCode.is_good()

    async def run():
        async with asyncua.Client(f"opc.tcp://127.0.0.1:{port}/piezod/") as client:
            index = await client.get_namespace_index("urn:piezod")
            (folder,) = [one for one in await client.nodes.objects.get_children() if one.nodeid.NamespaceIndex == index]
            force, age = await folder.get_child(f"{index}:force_N"), await folder.get_child(f"{index}:age_s")
            assert await good(force)
            control = running.control_pid()
            if how == "without a device":
                device.close()
            else:
                os.kill(control, signal.SIGKILL if how == "killed" else signal.SIGSTOP)
            if how == "killed":
                running.signal(signal.SIGKILL)
            try:
                deadline_s = time.monotonic() + WITHIN_S
                while await good(force):
                    assert time.monotonic() < deadline_s
                    await asyncio.sleep(0.05)
                if how == "without a device":
                    status = running.status()
                    assert status["state"] == "DISARMED"
                    assert (status["connected"], status["stale"]) == (False, True)
                    assert "no good exchange with the device" in status["problem"]
                return await age.read_value()
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(control, signal.SIGCONT)

    with contextlib.ExitStack() as device:
        served = device.enter_context(emulator("--port", "0"))
        path = bench_file(tmp_path, served, rate_Hz=100, limits=LONG_LIMITS)
        with daemon(path) as running:
            running.connected()
            with bridge(path, "--opcua", port):
                assert 1.0 < asyncio.run(run()) < WITHIN_S


def test_the_bridge_takes_the_age_from_the_last_good_exchange(tmp_path):
    log, now_ns = RingLog(tmp_path / "ring", 100), time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    rows = np.zeros(2, ROW_DTYPE)
    rows["tick"], rows["time_ns"], rows["result"] = (1, 2), (now_ns - 8 * 10**9, now_ns), (0, ExchangeResult.TIMEOUT)
    for row in rows:
        log.append(*row.tolist())
    newest = Newest(tmp_path / "ring", 0.01)
    values = newest.read()
    assert values["tick"] == 2
    assert values["age_s"] == pytest.approx(8.0, abs=0.5)
    assert newest.stale
    log.close()


def certificates_in(folder):
    """Of a server and of two clients, one of them known."""
    (folder / "clients").mkdir()
    for name in ("server", "known", "stranger"):
        openssl(
            "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}",
            "-addext", f"subjectAltName=URI:urn:{name},DNS:localhost", "-addext",
            "keyUsage=digitalSignature,nonRepudiation,keyEncipherment,dataEncipherment",
            "-keyout", folder / f"{name}.pem", "-outform", "DER",
            "-out", folder / ("clients/known.der" if name == "known" else f"{name}.der"),
        )  # fmt: skip
    return folder


def test_a_client_with_a_known_certificate_arms_and_stops_and_a_stranger_does_not_get_in(bench, tmp_path):
    asyncua = pytest.importorskip("asyncua")
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

    port, folder = free_port(), certificates_in(tmp_path)

    def client_of(certificate, key):
        client = asyncua.Client(f"opc.tcp://127.0.0.1:{port}/piezod/")
        client.application_uri = f"urn:{key.stem}"
        return client, client.set_security(SecurityPolicyBasic256Sha256, str(certificate), str(key))

    async def call(name):
        client, secured = client_of(folder / "clients" / "known.der", folder / "known.pem")
        await secured
        async with client:
            index = await client.get_namespace_index("urn:piezod")
            (bench_node,) = [
                one for one in await client.nodes.objects.get_children() if one.nodeid.NamespaceIndex == index
            ]
            await bench_node.call_method(f"{index}:{name}")

    async def intrude():
        client, secured = client_of(folder / "stranger.der", folder / "stranger.pem")
        await secured
        async with client:
            pass

    with bridge(bench, "--opcua", port, "--certificates", folder) as (_, line):
        assert "(methods for 1 clients)" in line
        asyncio.run(call("arm"))
        wait_for_state(bench, "RUNNING")
        asyncio.run(call("stop"))
        wait_for_state(bench, "DISARMED")
        with pytest.raises(Exception, match=r"(?i)denied|reject|identity|closed|invalid"):
            asyncio.run(intrude())


def wait_for_state(bench, wanted):
    deadline_s = time.monotonic() + WITHIN_S
    while json.loads(piezod("status", bench, "--json").stdout)["state"] != wanted:
        assert time.monotonic() < deadline_s
        time.sleep(0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "--mqtt or --opcua is missing"),
        (("--mqtt", "http://host"), "--mqtt is 'http://host', must be mqtt://"),
        (("--mqtt", "mqtt://user:secret@host:port"), "--mqtt is 'host:port', must be mqtt://"),
        (("--certificates", "."), "--mqtt or --opcua is missing"),
    ],
)
def test_what_cannot_be_bridged_is_refused_in_a_line(bench, options, message):
    done = piezod("bridge", bench, *options)
    assert done.returncode == 2
    assert done.stderr.startswith(f"piezod: {message}")
    assert "secret" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_folder_without_certificates_is_refused(bench, tmp_path):
    pytest.importorskip("asyncua")
    done = piezod("bridge", bench, "--opcua", free_port(), "--certificates", tmp_path)
    assert done.returncode == 78
    assert "holds no *.der" in done.stderr
