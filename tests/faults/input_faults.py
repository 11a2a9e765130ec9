"""Faults of inputs: bench file, model, recordings, names, TLS peers, metrics port and control socket."""

import contextlib
import json
import os
import pickle
import re
import shutil
import socket
import stat
import struct
import tomllib
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import yaml

from piezod.config import load_bench
from piezod.errors import PiezodError
from piezod.transport import make_link
from tests.benches.certificates import Authority
from tests.faults.bench_pool import InjectionUnavailableError, Observation, run_piezod, run_piezod_in_process
from tests.faults.live_bench import BENCH, ROOT
from tests.faults.running_faults import Watch
from tests.unit.transport.conftest import line_config
from tests.unit.transport.scripted import ScriptedLine


def bench_file(pool, fault, *, kind="edit", old="", new="", verb="run", times=1):
    """Run a command with a wrong bench file: an edited one, or one of `_KINDS`."""
    folder = pool.new_folder()
    path = folder / "bench.yaml"
    text = BENCH.read_text(encoding="utf-8").replace("model: model.yaml", f"model: {ROOT / 'config' / 'model.yaml'}", 1)
    text = text.replace("ring_log: /dev/shm/piezod-{name}.ring", f"ring_log: {folder / 'ring'}", 1)
    path.write_text(text, encoding="utf-8")
    if kind == "edit":
        assert old in text, old
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    else:
        path = _KINDS[kind](path, text, times)
    code, messages, after_ms = (run_piezod if verb == "run" else run_piezod_in_process)(verb, path)
    observed = Observation("none", code, messages, after_ms)
    observed.figures["lines"] = sum(line.startswith("piezod: ") for line in messages.splitlines())
    return observed


def _missing(path, _text, _times):
    path.unlink()
    return path


def _folder(path, _text, _times):
    path.unlink()
    path.mkdir()
    return path


def _binary(path, _text, _times):
    path.write_bytes(bytes(range(256)) * 20)
    return path


def _huge(path, _text, times):
    with path.open("wb") as file:
        file.truncate(times)
    return path


def _alias_bomb(path, _text, _times):
    levels = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    levels += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    path.write_text("\n".join(levels) + "\n", encoding="utf-8")
    return path


def _open_to_all(path, _text, _times):
    path.chmod(0o666)
    return path


_KINDS = {
    "missing": _missing,
    "folder": _folder,
    "binary": _binary,
    "huge": _huge,
    "bomb": _alias_bomb,
    "open_to_all": _open_to_all,
}


def tls(pool, fault):
    """Connect to four TLS peers with wrong certificates, and to a plain peer that must receive no request."""
    if shutil.which("openssl") is None:
        raise InjectionUnavailableError("openssl is not installed")
    folder = pool.new_folder()
    ours, stranger = Authority(folder, "ours"), Authority(folder, "stranger")
    good = ours.sign("device", address="IP:127.0.0.1")
    client = ours.sign("client")
    cases = {
        "wrong_ca": (stranger.sign("forged", address="IP:127.0.0.1"), client),
        "expired": (ours.sign("expired", address="IP:127.0.0.1", days=-1), client),
        "wrong_host": (ours.sign("elsewhere", address="IP:192.0.2.1"), client),
        "no_client_certificate": (good, stranger.sign("unknown")),
    }
    observed, messages = Observation("none"), []
    for name, (device, shown) in cases.items():
        with _tls_device(folder, device, ours) as (host, port):
            code, text = _connect_by_tls(folder, host, port, ours, shown)
        messages.append(f"{name}: {text}")
        observed.figures[name] = code
    with _eavesdropper() as (host, port, heard):
        code, text = _connect_by_tls(folder, host, port, ours, client)
        messages.append(f"plain peer: {text}")
        observed.figures["plain_peer"] = code
        observed.figures["plain_requests"] = float(not heard[0].startswith(b"\x16\x03") if heard else 0)
    observed.text = "\n".join(messages)
    return observed


@contextlib.contextmanager
def _tls_device(folder, device, authority):
    from tests.benches.emulator import EMULATOR, emulator

    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8"))
    settings = {"certificate": str(device.certificate), "key": str(device.key), "ca": str(authority.ca)}
    content["tcp"] |= {"tls": settings, "port": 0}
    path = folder / "emulator.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with emulator(config=path) as serves:
        host, _, port = serves["tcp"].rpartition(":")
        yield host, int(port)


@contextlib.contextmanager
def _eavesdropper():
    """A peer without TLS that records the received bytes and sends no answer."""
    import threading

    heard = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def attend():
            with contextlib.suppress(OSError):
                connection, _ = listener.accept()
                with connection:
                    connection.settimeout(3.0)
                    heard.append(connection.recv(4096))

        thread = threading.Thread(target=attend, daemon=True)
        thread.start()
        yield *listener.getsockname(), heard
        thread.join(4.0)


def _connect_by_tls(folder, host, port, authority, shown):
    """Exit code and message of an attempt to identify the device through TLS."""
    config = load_bench(BENCH).link
    material = {"ca": str(authority.ca), "certificate": str(shown.certificate), "key": str(shown.key)}
    link = make_link(type(config).model_validate(config.model_dump() | {"host": host, "port": port, "tls": material}))
    try:
        link.open()
        link.identify()
    except PiezodError as error:
        return error.exit_code, str(error)
    finally:
        link.close()
    return 0, "accepted"


def metrics(pool, fault):
    """Send other requests than GET /metrics to the metrics port, and check the address that it listens on."""
    bench = pool.bench()
    line = next(text for _, text in bench.service.log_lines if text.startswith("metrics: "))
    address = line.split()[1]
    port = int(address.rpartition(":")[2].partition("/")[0])
    refused = 0
    bench.device.ask("mark")
    for method, path in (("POST", "/arm"), ("GET", "/arm"), ("POST", "/metrics"), ("DELETE", "/"), ("PUT", "/reset")):
        request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", method=method, data=b"")
        try:
            urllib.request.urlopen(request, timeout=5)
        except urllib.error.HTTPError as error:
            refused += error.code == 404
            error.close()
    with urllib.request.urlopen(address, timeout=5) as page:
        served = float(b"piezod_state" in page.read())
    observed = Observation(bench.status()["state"])
    observed.figures = {
        "refused": refused,
        "served": served,
        "reached_from_outside": float(_listens_beyond_loopback(port)),
        "commands": bench.device.ask("report")["commands"],
    }
    observed.armings = bench.rearms
    return observed


def _listens_beyond_loopback(port):
    """Whether a listening socket of this port is bound to anything but 127.0.0.1."""
    found = []
    for name in ("/proc/net/tcp", "/proc/net/tcp6"):
        with contextlib.suppress(OSError):
            for row in Path(name).read_text(encoding="ascii").splitlines()[1:]:
                fields = row.split()
                address, _, hexadecimal = fields[1].rpartition(":")
                if fields[3] == "0A" and int(hexadecimal, 16) == port:
                    found.append(address)
    return any(address != "0100007F" for address in found)


def control_socket(pool, fault):
    """Check the file mode of the control socket, and that the log names the user of a command."""
    bench = pool.bench()
    found = (bench.folder / "ring.sock").stat()
    log_start = len(bench.service.log_lines)
    bench.send_command("reload")
    bench.service.wait_for("socket: reload by uid", since=log_start)
    observed = Observation(bench.status()["state"], text=bench.service.log(log_start))
    observed.figures = {
        "mode_octal": float(f"{stat.S_IMODE(found.st_mode):o}"),
        "others_may": float(bool(found.st_mode & 0o007)),
    }
    return observed


def hostile_clients(pool, fault, *, lines, longest, slow_s):
    """Send malformed, endless and incomplete messages to the control socket while the bench drives."""
    bench = pool.bench()
    bench.arm()
    watch, observed = Watch(bench), Observation()
    answers = []
    path = str(bench.folder / "ring.sock")
    slow = socket.socket(socket.AF_UNIX)
    slow.connect(path)
    for k in range(longest):
        with contextlib.suppress(OSError):
            slow.sendall(b"{")
            if k % 1000 == 0:
                slow.setblocking(False)
    slow.close()
    for line in lines:
        with socket.socket(socket.AF_UNIX) as client, contextlib.suppress(OSError):
            client.settimeout(3.0)
            client.connect(path)
            client.sendall(line.encode("latin-1") + b"\n")
            answers.append(client.recv(4096))
    watch.until(fault.expect.states, slow_s, fault.within_ms)
    watch.finish(observed)
    observed.figures["refused"] = sum(b'"ok": false' in one for one in answers)
    bench.restore()
    observed.armings = bench.rearms
    return observed


class _PickledCommand:
    """An object that makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def malicious_files(pool, fault):
    """Read recordings and a model with embedded programs, absurd sizes and compressed archives."""
    folder = pool.new_folder()
    mark = folder / "executed"
    pickled_command = pickle.dumps(_PickledCommand(mark))
    good = folder / "good.csv"
    good.write_text(
        "time_s,voltage_V,force_N\n" + "\n".join(f"{k / 100},{k % 50},{k % 50}" for k in range(200)), encoding="utf-8"
    )
    files = {}
    for suffix in ("csv", "h5", "mat", "tdms", "parquet", "mf4"):
        files[f"pickle.{suffix}"] = pickled_command
    array = np.array([{"a": 1}], dtype=object)
    np.save(folder / "object.npy", array, allow_pickle=True)
    files["npy.mat"] = (folder / "object.npy").read_bytes()
    files["huge.mat"] = (
        b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49) + struct.pack("<II", 14, 0xFFFFFFF0)
    )
    with zipfile.ZipFile(folder / "z", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", b"\0" * 50_000_000)
    files["zip.h5"] = (folder / "z").read_bytes()
    codes, messages = [], []
    for name, content in files.items():
        path = folder / name
        path.write_bytes(content)
        code, text, _ = run_piezod_in_process("identify", path, "-o", folder / "m.yaml")
        codes.append(code)
        messages.append(text)
    model = folder / "model.yaml"
    model.write_text(f"!!python/object/apply:os.mkdir ['{mark}']\n", encoding="utf-8")
    code, text, _ = run_piezod_in_process("simulate", good, "--model", model, "-o", folder / "out.csv")
    codes.append(code)
    messages.append(text)
    observed = Observation("none", max(codes), "\n".join(messages))
    observed.figures = {
        "files": len(codes),
        "refused": sum(code in (1, 2, 78) for code in codes),
        "executed": float(mark.exists()),
    }
    return observed


def hostile_names(pool, fault, *, names):
    """Run with bench names that are paths, which would place files outside the folders of the bench."""
    codes, messages = [], []
    for name in names:
        observed = bench_file(pool, fault, old="name: emulator ", new=f"name: {json.dumps(name)} ")
        codes.append(observed.exit_code)
        messages.append(observed.text)
    found = Observation("none", max(codes), "\n".join(messages))
    found.figures = {"refused": sum(code == 78 for code in codes), "names": len(names)}
    return found


def hostile_column(pool, fault, *, column):
    """Identify with a channel name that is a script, and search the report page for it."""
    folder = pool.new_folder()
    random = np.random.default_rng(1)
    time_s = np.arange(4000) / 100
    voltage_V = 70 + 70 * np.sin(time_s)
    force_N = 2 * voltage_V + random.normal(0, 0.1, time_s.size)
    rows = "\n".join(f"{a:.3f},{b:.5f},{c:.5f}" for a, b, c in zip(time_s, voltage_V, force_N, strict=True))
    record = folder / "rec.csv"
    record.write_text(f'time_s,voltage_V,"{column}"\n{rows}\n', encoding="utf-8")
    code, text, after_ms = run_piezod_in_process(
        "identify", record, "-o", folder / "m.yaml", "--output", column, "--report", folder / "page",
        "--plays", "3", "--dead-zones", "0",
    )  # fmt: skip
    pages = list((folder / "page").glob("*.html")) if (folder / "page").exists() else []
    page = "".join(one.read_text(encoding="utf-8") for one in pages)
    observed = Observation("none", code, text, after_ms)
    observed.figures = {
        "pages": len(pages),
        "programs_in_it": page.count("<script>alert"),
        "remote": len(re.findall(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=[\"']?https?:", page)),
    }
    return observed


def hostile_device(pool, fault, *, answer):
    """Identify a device whose reported name contains line breaks and terminal control sequences."""
    with ScriptedLine() as server:
        server.answer = lambda frame, _: [
            answer.encode("latin-1") + b"\n" if frame.startswith(b"ID") else server.good(frame)
        ]
        link = make_link(line_config(server.port))
        link.open()
        try:
            link.identify()
        except PiezodError as error:
            observed = Observation("none", error.exit_code, str(error))
        finally:
            link.close()
    observed.figures = {
        "lines": len(observed.text.splitlines()),
        "control_characters": sum(ord(one) < 32 or ord(one) == 127 for one in observed.text),
    }
    return observed


def secrets(pool, fault):
    """Use a TLS key that others can read, and search status, log and `piezod check` for its content."""
    folder = pool.new_folder()
    if shutil.which("openssl") is None:
        raise InjectionUnavailableError("openssl is not installed")
    ours = Authority(folder, "ours")
    client = ours.sign("client")
    key = client.key.read_text(encoding="ascii")
    client.key.chmod(0o644)
    code, text = _connect_by_tls(folder, "127.0.0.1", 1, ours, client)
    client.key.chmod(0o600)
    bench = pool.bench()
    shown = json.dumps(bench.status()) + bench.service.log() + run_piezod_in_process("check", bench.path)[1]
    unit = (ROOT / "systemd" / "piezod.service").read_text(encoding="utf-8")
    observed = Observation(bench.status()["state"], code, text)
    body = "".join(key.splitlines()[1:-1])
    observed.figures = {
        "shown": float(body[:40] in shown or "PRIVATE KEY" in shown),
        "loaded_as_credential": float("LoadCredential=" in unit and "CREDENTIALS_DIRECTORY" in unit),
    }
    return observed


def dependencies(pool, fault):
    """Check that the constraints file pins every dependency of the daemon."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lock = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").lower().replace("_", "-").splitlines()
    pinned = {line.partition("==")[0] for line in lock if "==" in line}
    wanted = [one.partition(">")[0].strip().lower() for one in project["project"]["dependencies"]]
    missing = [name for name in wanted if name not in pinned]
    observed = Observation("none", text=f"not pinned: {', '.join(missing) or 'none'}")
    observed.figures = {"dependencies": len(wanted), "not_pinned": len(missing)}
    return observed


INJECTORS = {
    "bench_file": bench_file,
    "tls": tls,
    "metrics": metrics,
    "control_socket": control_socket,
    "hostile_clients": hostile_clients,
    "malicious_files": malicious_files,
    "hostile_names": hostile_names,
    "hostile_column": hostile_column,
    "hostile_device": hostile_device,
    "secrets": secrets,
    "dependencies": dependencies,
}
