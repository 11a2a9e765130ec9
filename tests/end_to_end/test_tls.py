"""Modbus/TCP Security: who is believed, who is refused, and that nothing is ever said in plain."""

import json
import shutil
import socket
import ssl
import subprocess
import threading

import pytest
import yaml

from tests.benches.certificates import Authority
from tests.benches.daemon import PATIENT, daemon
from tests.benches.emulator import EMULATOR, bench_file, emulator, piezod

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")


class Bench:
    """An emulated bench that serves TLS alone, and the files of both sides."""

    def __init__(self, folder):
        self.folder = folder
        self.authority, self.stranger = Authority(folder, "ours"), Authority(folder, "stranger")
        self.device = self.authority.sign("device", address="IP:127.0.0.1")
        self.client = self.authority.sign("client")

    def serve(self, device=None):
        content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8"))
        device = device or self.device
        tls = {"certificate": str(device.certificate), "key": str(device.key), "ca": str(self.authority.ca)}
        content["tcp"] |= {"tls": tls, "port": 0}
        path = self.folder / "emulator.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return emulator(config=path)

    def file(self, serves, **changes):
        tls = {
            "ca": str(self.authority.ca),
            "certificate": str(self.client.certificate),
            "key": str(self.client.key),
        }
        path = bench_file(self.folder, serves, rate_Hz=200, limits=PATIENT, arming={"reset_cycle": False})
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content["link"]["tls"] = tls | {name: str(value) for name, value in changes.items()}
        content["reference"]["duration_s"] = 1.0
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("tls"))


def refused(done, code, says):
    assert done.returncode == code, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr


def test_a_reference_is_followed_through_tls(bench):
    with bench.serve() as serves:
        done = piezod("run", bench.file(serves), "--arm", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["tracking"]["ticks"] > 150
    assert result["tracking"]["rms_error_N"] < 2.0
    assert set(result["results"]) == {"ok"}


def test_a_device_signed_by_a_stranger_is_refused(bench):
    device = bench.stranger.sign("forged", address="IP:127.0.0.1")
    with bench.serve(device) as serves:
        refused(
            piezod("run", bench.file(serves), "--arm"), 78, "its certificate is refused: unable to get local issuer"
        )


def test_a_certificate_for_another_address_is_refused(bench):
    device = bench.authority.sign("elsewhere", address="IP:192.0.2.1")
    with bench.serve(device) as serves:
        refused(piezod("run", bench.file(serves), "--arm"), 78, "IP address mismatch")


def test_a_name_may_be_given_for_a_device_that_is_reached_by_its_address(bench):
    device = bench.authority.sign("named", address="DNS:bench.example")
    with bench.serve(device) as serves:
        done = piezod("run", bench.file(serves, server_name="bench.example"), "--arm")
        assert done.returncode == 0, done.stderr
        refused(piezod("run", bench.file(serves, server_name="other.example"), "--arm"), 78, "Hostname mismatch")


def test_an_expired_certificate_is_refused(bench):
    device = bench.authority.sign("expired", address="IP:127.0.0.1", days=-1)
    with bench.serve(device) as serves:
        refused(piezod("run", bench.file(serves), "--arm"), 78, "certificate has expired")


def test_a_client_that_the_device_does_not_know_is_told_so(bench):
    stranger = bench.stranger.sign("unknown-client")
    with bench.serve() as serves:
        path = bench.file(serves, certificate=stranger.certificate, key=stranger.key)
        refused(piezod("run", path, "--arm"), 75, "or it refuses link.tls.certificate")


def test_a_device_that_says_why_it_refuses_the_client_is_quoted(bench):
    stranger = bench.stranger.sign("quoted-client")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    files = ("-cert", bench.device.certificate, "-key", bench.device.key, "-CAfile", bench.authority.ca)
    server = subprocess.Popen(
        ["openssl", "s_server", "-accept", f"127.0.0.1:{port}", *files, "-Verify", "1", "-verify_return_error"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with server:
        for line in server.stdout:
            if line.startswith(b"ACCEPT"):
                break
        path = bench.file({"tcp": f"127.0.0.1:{port}"}, certificate=stranger.certificate, key=stranger.key)
        refused(piezod("run", path, "--arm"), 78, "alert unknown ca")
        server.kill()


def test_a_device_that_speaks_plain_is_not_spoken_to(bench):
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as plain:

        def listen():
            for _ in range(2):
                connection, _ = plain.accept()
                with connection:
                    connection.settimeout(3)
                    heard.append(connection.recv(4096))

        thread = threading.Thread(target=listen, daemon=True)
        thread.start()
        path = bench.file({"tcp": f"127.0.0.1:{plain.getsockname()[1]}"})
        done = piezod("run", path, "--arm")
    assert done.returncode in (75, 78), done.stderr
    assert all(data[:2] == b"\x16\x03" for data in heard), heard  # a TLS handshake, and nothing else


def test_the_plain_emulator_is_refused_by_a_tls_client_and_the_tls_emulator_by_a_plain_one(bench):
    with emulator("--port", "0") as serves:
        done = piezod("run", bench.file(serves), "--arm")
        assert done.returncode in (75, 78), done.stderr
    with bench.serve() as serves:
        path = bench_file(bench.folder, serves, rate_Hz=200, limits=PATIENT)
        assert piezod("run", path, "--arm").returncode in (75, 78)


def test_tls_1_1_is_not_spoken(bench):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(bench.device.certificate, bench.device.key)
    context.set_ciphers("DEFAULT:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1_1"):
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            try:
                context.wrap_socket(connection, server_side=True).close()
            except OSError:
                connection.close()

        threading.Thread(target=serve, daemon=True).start()
        done = piezod("run", bench.file({"tcp": f"127.0.0.1:{server.getsockname()[1]}"}), "--arm")
    refused(done, 78, "no TLS connection")


def test_a_connection_that_is_cut_is_made_again_with_tls_and_stays_disarmed(bench):
    with bench.serve() as serves:
        path = bench.file(serves)
        with daemon(path) as service:
            service.connected()
            for _ in range(3):
                cut(int(serves["tcp"].rpartition(":")[2]))
                before = service.status()["results"]["ok"]
                service.wait_until(lambda: service.status()["results"]["ok"] > before + 20, "readings again")  # noqa: B023
            status = service.status()
            assert status["state"] == "DISARMED"
            assert status["failed_exchanges"] >= 1


def cut(port):
    """End the connections to a port, as a switch that forgets them would (ss -K); skipped where it cannot."""
    done = subprocess.run(["ss", "-K", "dst", "127.0.0.1", "dport", "=", str(port)], capture_output=True, check=False)
    if done.returncode or not done.stdout.strip():
        pytest.skip(f"ss -K does not end connections here: {done.stderr.decode()[:80]}")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"ca": "/nowhere/ca.pem"}, "link.tls.ca: /nowhere/ca.pem is no file"),
        ({"key": "$CREDENTIALS_DIRECTORY/key"}, "systemd gave no credentials"),
        ({"certificate": "KEY"}, "link.tls.certificate"),
        ({"key": "OPEN"}, "can be read by everybody"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(bench, change, says):
    readable = bench.folder / "open.key"
    readable.write_bytes(bench.client.key.read_bytes())
    readable.chmod(0o644)
    stands_for = {"KEY": bench.client.key, "OPEN": readable}
    changes = {name: stands_for.get(value, value) for name, value in change.items()}
    refused(piezod("run", bench.file({"tcp": "127.0.0.1:4"}, **changes), "--arm"), 78, says)
