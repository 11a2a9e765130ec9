"""Content of a support bundle, and secrets that it must not contain."""

import json
import zipfile

import numpy as np
import pytest
import yaml

from piezod.commissioning import support_bundle
from piezod.commissioning.shipped_files import shipped
from piezod.commissioning.support_bundle import without_lines, write_bundle
from piezod.config import BenchConfig, read_document
from piezod.control import ROW_DTYPE, Cause, RingLog, State
from piezod.errors import ConfigurationError, TemporaryError, UsageError

SECRET = {"ca": "/etc/pki/plant-ca.pem", "certificate": "/etc/pki/me.pem", "key": "/etc/pki/secret.key"}


@pytest.fixture
def config(tmp_path):
    """A bench with secrets, and a ring log of an earlier run."""
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    content["link"] |= {"host": "press.plant.example", "tls": SECRET}
    content["daemon"] |= {"ring_log": str(tmp_path / "ring"), "socket_group": "pressroom"}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    (tmp_path / "model.yaml").write_bytes(shipped("model.yaml").read_bytes())
    rows = np.zeros(30, ROW_DTYPE)
    rows["tick"] = np.arange(30)
    rows["state"], rows["force_N"] = State.RUNNING, 12.25
    rows["state"][20:], rows["cause"][20:] = State.FAULT, Cause.OVER_FORCE
    log = RingLog(tmp_path / "ring", 100)
    for row in rows:
        log.append(*row.tolist())
    log.close()
    return path


def contents(path):
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name).decode() for name in bundle.namelist()}


def test_no_secret_is_in_the_bundle(config, tmp_path):
    write_bundle(config, tmp_path / "out.zip")
    text = "".join(contents(tmp_path / "out.zip").values())
    for secret in (*SECRET.values(), "press.plant.example", "pressroom"):
        assert secret not in text
    assert text.count("REMOVED") >= 5
    assert (tmp_path / "out.zip").stat().st_mode & 0o777 == 0o600


def test_lines_of_a_protocol_are_removed_and_numbers_stay(tmp_path):
    write_bundle(shipped("pi_e625.yaml"), tmp_path / "out.zip")
    shown = yaml.safe_load(contents(tmp_path / "out.zip")["bench.yaml"])
    assert shown["link"]["set_voltage"]["send"] == "REMOVED"
    assert shown["link"]["setup"] == [{"reply": None, "send": "REMOVED"}, {"reply": "REMOVED", "send": "REMOVED"}]
    assert shown["link"]["baudrate"] == 115200
    assert shown["load_cell_link"]["host"].startswith("192.168.")


PASSWORDS = [
    'LOGIN "pw-4711"',
    "LOGIN 'pw-4711'",
    "LOGIN \"a'pw-4711",
    "LOGIN \\pw-4711",
    "LOGIN pw-4711\u00e4\t\u20ac",
    "LOGIN pw-4711 ",
]


@pytest.mark.parametrize("send", PASSWORDS)
def test_a_password_is_removed_in_whatever_form_a_message_quotes_it(tmp_path, monkeypatch, send):
    content = yaml.safe_load(shipped("pi_e625.yaml").read_text(encoding="utf-8"))
    content["link"]["setup"] = [{"send": send, "reply": 'OK "pw-4711"'}]
    content["name"] = "stack-1"
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    problem = TemporaryError(f"link.setup[0], {send!r}, ended in timeout: {send}")
    answers = {"status": {"problem": str(problem), "more": [send, {"text": f"sent {send}"}]}, "log": {"lines": []}}
    answers["log"]["lines"] = [
        str(problem),
        f"sent {send}",
        json.dumps({"sent": send}),
        ascii(send),
        repr(send.encode()),
    ]

    class Daemon:
        def ask(self, name):
            return answers[name]

        def close(self):
            pass

    monkeypatch.setattr(support_bundle, "Client", lambda _: Daemon())
    monkeypatch.setattr(support_bundle, "_rows", lambda _: np.zeros(0, ROW_DTYPE))
    monkeypatch.setattr(support_bundle, "_model", lambda *_: {"problem": f'sent "{send}"'})
    write_bundle(path, tmp_path / "out.zip")
    parts = contents(tmp_path / "out.zip")
    assert {"status.json", "log.txt", "bench.yaml"} <= set(parts)
    assert [name for name, text in parts.items() if "pw-4711" in text] == []
    assert json.loads(parts["status.json"])["more"][1]["text"].strip() == "sent REMOVED"


def test_the_bundle_contains_versions_machine_model_and_the_last_ticks(config, tmp_path):
    about = write_bundle(config, tmp_path / "out.zip")
    parts = contents(tmp_path / "out.zip")
    assert json.loads(parts["bundle.json"]) == about
    assert len(about["model"]["sha256"]) == 64
    assert about["versions"]["numpy"] == np.__version__
    assert list(about["left_out"]) == ["status.json", "log.txt"]
    assert parts["transitions.txt"].splitlines() == [
        "tick 0: RUNNING, started",
        "tick 20: FAULT, force above limits.force_trip_N; check specimen, reference and load cell",
    ]
    lines = parts["ticks.csv"].splitlines()
    assert len(lines) == 31
    assert lines[0].startswith("tick,time_ns,reference_N")
    assert ",12.25," in lines[1]


def test_the_configuration_in_it_can_be_read_as_yaml(config, tmp_path):
    write_bundle(config, tmp_path / "out.zip")
    path = tmp_path / "shown.yaml"
    path.write_text(contents(tmp_path / "out.zip")["bench.yaml"], encoding="utf-8")
    assert read_document(path).content["limits"]["slew_V_per_s"] == 4000.0


def test_a_bundle_can_be_made_for_a_bench_that_never_ran(tmp_path):
    path = tmp_path / "bench.yaml"
    text = shipped("bench.yaml").read_text(encoding="utf-8").replace("/dev/shm/", f"{tmp_path}/none/")
    path.write_text(text, encoding="utf-8")
    about = write_bundle(path, tmp_path / "out.zip")
    assert set(about["left_out"]) == {"status.json", "log.txt", "ticks.csv", "transitions.txt"}
    assert "cannot be read" in about["model"]["problem"]


def test_an_existing_bundle_is_not_replaced(config, tmp_path):
    (tmp_path / "out.zip").write_text("mine", encoding="utf-8")
    with pytest.raises(UsageError, match="already exists"):
        write_bundle(config, tmp_path / "out.zip")
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_bundle(config, tmp_path / "nowhere" / "out.zip")


@pytest.mark.parametrize(("reply", "shown"), [("45 52 52 0a", "45 52 52 0a"), ("49 44 3f 20 78", "REMOVED")])
def test_lines_of_a_protocol_are_removed_from_a_failed_exchange_too(reply, shown):
    content = yaml.safe_load(shipped("pi_e625.yaml").read_text(encoding="utf-8"))
    content["link"]["identity"] = {"send": "ID? x", "reply": "ID. x"}
    bench = BenchConfig.model_validate(content)
    exchange = {"link": "link", "request": "49 44 3f 20 78 0a", "reply": reply, "result": "malformed"}
    left = without_lines(exchange, bench)
    assert (left["request"], left["reply"]) == ("REMOVED", shown)
    assert without_lines(exchange | {"link": "load_cell_link"}, bench)["reply"] == reply
