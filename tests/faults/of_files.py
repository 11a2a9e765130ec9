"""Faults of what people write: the bench file, its model, recordings, names; and of what devices call themselves."""

import contextlib
import json
import os
import pickle
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
from tests.faults.at_work import Watch
from tests.faults.live import BENCH, ROOT
from tests.faults.stand import CannotBeDoneHereError, Seen, apart, command
from tests.unit.transport.conftest import line_config
from tests.unit.transport.scripted import ScriptedLine


def bench_file(stand, fault, *, kind="edit", old="", new="", verb="run", times=1):
    """Give a command a bench file that is wrong: edited, or no such file at all."""
    folder = stand.new_folder()
    path = folder / "bench.yaml"
    text = BENCH.read_text(encoding="utf-8").replace("model: model.yaml", f"model: {ROOT / 'config' / 'model.yaml'}", 1)
    text = text.replace("ring_log: /dev/shm/piezod-{name}.ring", f"ring_log: {folder / 'ring'}", 1)
    path.write_text(text, encoding="utf-8")
    if kind == "edit":
        assert old in text, old
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    else:
        path = _KINDS[kind](path, text, times)
    code, said, after_ms = (apart if verb == "run" else command)(verb, path)
    seen = Seen("none", code, said, after_ms)
    seen.figures["lines"] = sum(line.startswith("piezod: ") for line in said.splitlines())
    return seen


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


def _bomb(path, _text, _times):
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
    "bomb": _bomb,
    "open_to_all": _open_to_all,
}


def another_model(stand, fault, *, old, new):
    """A model of something else than this bench."""
    bench = stand.bench()
    bench.service.end()
    bench.drop()
    folder = stand.new_folder()
    model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    assert old in model, old
    (folder / "model.yaml").write_text(model.replace(old, new, 1), encoding="utf-8")
    text = bench.path.read_text(encoding="utf-8")
    path = folder / "bench.yaml"
    path.write_text(text.replace(str(ROOT / "config" / "model.yaml"), str(folder / "model.yaml"), 1), encoding="utf-8")
    bench.stage.ask("mark")
    code, said, after_ms = apart("run", path, "--arm")
    report = bench.stage.ask("report")
    seen = Seen("DISARMED", code, said, after_ms, wrong=report["wrong"])
    seen.figures["commands"] = report["commands"]
    bench.heal()
    return seen


def tls(stand, fault):
    """Four peers that must not be believed, or will not believe us; and what a plain one gets to see."""
    if shutil.which("openssl") is None:
        raise CannotBeDoneHereError("openssl is not installed")
    folder = stand.new_folder()
    ours, stranger = Authority(folder, "ours"), Authority(folder, "stranger")
    good = ours.sign("device", address="IP:127.0.0.1")
    client = ours.sign("client")
    cases = {
        "wrong_ca": (stranger.sign("forged", address="IP:127.0.0.1"), client),
        "expired": (ours.sign("expired", address="IP:127.0.0.1", days=-1), client),
        "wrong_host": (ours.sign("elsewhere", address="IP:192.0.2.1"), client),
        "no_client_certificate": (good, stranger.sign("unknown")),
    }
    seen, said = Seen("none"), []
    for name, (device, shown) in cases.items():
        with _tls_device(folder, device, ours) as (host, port):
            code, text = _connect_by_tls(folder, host, port, ours, shown)
        said.append(f"{name}: {text}")
        seen.figures[name] = code
    with _eavesdropper() as (host, port, heard):
        code, text = _connect_by_tls(folder, host, port, ours, client)
        said.append(f"plain peer: {text}")
        seen.figures["plain_peer"] = code
        seen.figures["plain_requests"] = float(not heard[0].startswith(b"\x16\x03") if heard else 0)
    seen.text = "\n".join(said)
    return seen


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
    """A peer that speaks no TLS: it keeps what it is sent and answers nothing."""
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
    return 0, "believed"


def metrics(stand, fault):
    """Everything that the metrics' port might be asked for besides metrics, and from where."""
    bench = stand.bench()
    line = next(text for _, text in bench.service.said if text.startswith("metrics: "))
    address = line.split()[1]
    port = int(address.rpartition(":")[2].partition("/")[0])
    refused = 0
    bench.stage.ask("mark")
    for method, path in (("POST", "/arm"), ("GET", "/arm"), ("POST", "/metrics"), ("DELETE", "/"), ("PUT", "/reset")):
        request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", method=method, data=b"")
        try:
            urllib.request.urlopen(request, timeout=5)
        except urllib.error.HTTPError as error:
            refused += error.code == 404
            error.close()
    with urllib.request.urlopen(address, timeout=5) as page:
        served = float(b"piezod_state" in page.read())
    seen = Seen(bench.status()["state"])
    seen.figures = {
        "refused": refused,
        "served": served,
        "reached_from_outside": float(_listens_beyond_loopback(port)),
        "commands": bench.stage.ask("report")["commands"],
    }
    seen.armings = bench.rearms
    return seen


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


def control_socket(stand, fault):
    """Who may speak to the daemon, and that it says who did."""
    bench = stand.bench()
    found = (bench.folder / "ring.sock").stat()
    said = len(bench.service.said)
    bench.tell("reload")
    bench.service.wait_for("socket: reload by uid", since=said)
    seen = Seen(bench.status()["state"], text=bench.service.log(said))
    seen.figures = {
        "mode_octal": float(f"{stat.S_IMODE(found.st_mode):o}"),
        "others_may": float(bool(found.st_mode & 0o007)),
    }
    return seen


def hostile_clients(stand, fault, *, lines, longest, slow_s):
    """What is no command, what never ends, and what never comes; while the bench is at work."""
    bench = stand.bench()
    bench.arm()
    watch, seen = Watch(bench), Seen()
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
    watch.tell(seen)
    seen.figures["refused"] = sum(b'"ok": false' in one for one in answers)
    bench.heal()
    seen.armings = bench.rearms
    return seen


class _Evil:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def malicious_files(stand, fault):
    """Recordings and models that carry programs, sizes that nobody has, archives that unfold."""
    folder = stand.new_folder()
    mark = folder / "executed"
    evil = pickle.dumps(_Evil(mark))
    good = folder / "good.csv"
    good.write_text(
        "time_s,voltage_V,force_N\n" + "\n".join(f"{k / 100},{k % 50},{k % 50}" for k in range(200)), encoding="utf-8"
    )
    files = {}
    for suffix in ("csv", "h5", "mat", "tdms", "parquet", "mf4"):
        files[f"pickle.{suffix}"] = evil
    array = np.array([{"a": 1}], dtype=object)
    np.save(folder / "object.npy", array, allow_pickle=True)
    files["npy.mat"] = (folder / "object.npy").read_bytes()
    files["huge.mat"] = (
        b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49) + struct.pack("<II", 14, 0xFFFFFFF0)
    )
    with zipfile.ZipFile(folder / "z", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", b"\0" * 50_000_000)
    files["zip.h5"] = (folder / "z").read_bytes()
    codes, said = [], []
    for name, content in files.items():
        path = folder / name
        path.write_bytes(content)
        code, text, _ = command("identify", path, "-o", folder / "m.yaml")
        codes.append(code)
        said.append(text)
    model = folder / "model.yaml"
    model.write_text(f"!!python/object/apply:os.mkdir ['{mark}']\n", encoding="utf-8")
    code, text, _ = command("simulate", good, "--model", model, "-o", folder / "out.csv")
    codes.append(code)
    said.append(text)
    seen = Seen("none", max(codes), "\n".join(said))
    seen.figures = {
        "files": len(codes),
        "refused": sum(code in (1, 2, 78) for code in codes),
        "executed": float(mark.exists()),
    }
    return seen


def hostile_names(stand, fault, *, names):
    """A bench that calls itself a path: its files would lie where it likes."""
    codes, said = [], []
    for name in names:
        seen = bench_file(stand, fault, old="name: emulator ", new=f"name: {json.dumps(name)} ")
        codes.append(seen.exit_code)
        said.append(seen.text)
    found = Seen("none", max(codes), "\n".join(said))
    found.figures = {"refused": sum(code == 78 for code in codes), "names": len(names)}
    return found


def hostile_column(stand, fault, *, column):
    """A channel whose name is a program, in the page that shows it."""
    folder = stand.new_folder()
    random = np.random.default_rng(1)
    time_s = np.arange(4000) / 100
    voltage_V = 70 + 70 * np.sin(time_s)
    force_N = 2 * voltage_V + random.normal(0, 0.1, time_s.size)
    rows = "\n".join(f"{a:.3f},{b:.5f},{c:.5f}" for a, b, c in zip(time_s, voltage_V, force_N, strict=True))
    record = folder / "rec.csv"
    record.write_text(f'time_s,voltage_V,"{column}"\n{rows}\n', encoding="utf-8")
    code, text, after_ms = command(
        "identify", record, "-o", folder / "m.yaml", "--output", column, "--report", folder / "page",
        "--plays", "3", "--dead-zones", "0",
    )  # fmt: skip
    pages = list((folder / "page").glob("*.html")) if (folder / "page").exists() else []
    page = "".join(one.read_text(encoding="utf-8") for one in pages)
    seen = Seen("none", code, text, after_ms)
    seen.figures = {
        "pages": len(pages),
        "programs_in_it": page.count("<script>alert"),
        "remote": page.count('src="http'),
    }
    return seen


def hostile_device(stand, fault, *, answer):
    """A device whose name for itself carries line breaks and terminal commands."""
    with ScriptedLine() as server:
        server.answer = lambda frame, _: [
            answer.encode("latin-1") + b"\n" if frame.startswith(b"ID") else server.good(frame)
        ]
        link = make_link(line_config(server.port))
        link.open()
        try:
            link.identify()
        except PiezodError as error:
            seen = Seen("none", error.exit_code, str(error))
        finally:
            link.close()
    seen.figures = {
        "lines": len(seen.text.splitlines()),
        "control_characters": sum(ord(one) < 32 or ord(one) == 127 for one in seen.text),
    }
    return seen


def secrets(stand, fault):
    """A key for TLS: who may read it, and where it is shown."""
    folder = stand.new_folder()
    if shutil.which("openssl") is None:
        raise CannotBeDoneHereError("openssl is not installed")
    ours = Authority(folder, "ours")
    client = ours.sign("client")
    key = client.key.read_text(encoding="ascii")
    client.key.chmod(0o644)
    code, text = _connect_by_tls(folder, "127.0.0.1", 1, ours, client)
    client.key.chmod(0o600)
    bench = stand.bench()
    shown = json.dumps(bench.status()) + bench.service.log() + command("check", bench.path)[1]
    unit = (ROOT / "systemd" / "piezod.service").read_text(encoding="utf-8")
    seen = Seen(bench.status()["state"], code, text)
    body = "".join(key.splitlines()[1:-1])
    seen.figures = {
        "shown": float(body[:40] in shown or "PRIVATE KEY" in shown),
        "loaded_as_credential": float("LoadCredential=" in unit and "CREDENTIALS_DIRECTORY" in unit),
    }
    return seen


def dependencies(stand, fault):
    """Every dependency of the daemon stands in the lock with one version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lock = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").lower().replace("_", "-").splitlines()
    pinned = {line.partition("==")[0] for line in lock if "==" in line}
    wanted = [one.partition(">")[0].strip().lower() for one in project["project"]["dependencies"]]
    missing = [name for name in wanted if name not in pinned]
    seen = Seen("none", text=f"not pinned: {', '.join(missing) or 'none'}")
    seen.figures = {"dependencies": len(wanted), "not_pinned": len(missing)}
    return seen


INJECTORS = {
    "bench_file": bench_file,
    "another_model": another_model,
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
