"""Examples for other systems: what they name is what the daemon really offers."""

import asyncio
import importlib.util
import json
import re
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from piezod.control import ROW_DTYPE, Cause, State
from piezod.daemon.metrics import BenchMetrics
from piezod.daemon.service import COMMANDS
from piezod.daemon.statistics import TickStatistics
from piezod.estimation.recordings.intake import load_recordings
from piezod.recording import Recording, read_recording, write_recording
from piezod.recording.files import convert

CONFIG = Path(__file__).parents[2] / "config"
WORDS = {"by", "le", "state", "cause", "result", "bench", "sum", "rate", "max", "label_values", "histogram_quantile"}


class Recorder:
    """What a recorder's watch says."""

    def as_dict(self):
        names = ("degraded", "last_tick", "bytes", "commit_s", "rows", "dropped", "failures", "restarts")
        return dict.fromkeys(names, 0)


@pytest.fixture
def tally():
    """Ticks, among them a fault."""
    rows = np.zeros(5, ROW_DTYPE)
    rows["tick"] = np.arange(5)
    rows["force_N"], rows["temperature_C"] = 12.5, 21.0
    rows["state"] = [0, 1, 2, 2, 5]
    rows["cause"][4] = Cause.OVER_FORCE
    made = TickStatistics(lambda *_: None)
    made.add(rows)
    return made


@pytest.fixture
def exported(tally):
    """Names of every sample that the daemon exports, and their labels."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(BenchMetrics("press", tally, Recorder()))
    families = text_string_to_metric_families(generate_latest(registry).decode())
    return {sample.name: set(sample.labels) for family in families for sample in family.samples}


def expressions():
    dashboard = json.loads((CONFIG / "grafana_dashboard.json").read_text(encoding="utf-8"))
    found = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    return found + [one["query"]["query"] for one in dashboard["templating"]["list"] if isinstance(one["query"], dict)]


@pytest.mark.parametrize("expression", expressions())
def test_every_metric_of_the_dashboard_is_exported_with_the_labels_it_asks_for(expression, exported):
    names = re.findall(r"\bpiezod_[a-z_]+", expression)
    assert names
    assert set(names) <= set(exported)
    asked = set(re.findall(r"(\w+)(?==\"|!=\")", expression)) | set(re.findall(r"by \((\w+)\)", expression))
    assert asked <= set().union(*(exported[name] for name in names))


def test_panels_of_the_dashboard_do_not_overlap():
    panels = json.loads((CONFIG / "grafana_dashboard.json").read_text(encoding="utf-8"))["panels"]
    taken = [
        (x, y)
        for place in (panel["gridPos"] for panel in panels)
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(taken) == len(set(taken))
    assert max(x for x, _ in taken) < 24
    assert len({panel["id"] for panel in panels}) == len(panels)


def records():
    """Kind, name and fields of every EPICS record."""
    text = re.sub(r"#.*", "", (CONFIG / "piezod.db").read_text(encoding="utf-8"))
    whole = r"record\((\w+),\s*\"([^\"]+)\"\)\s*\{((?:\s*field\(\w+,\s*\"[^\"]*\"\))*)\s*\}"
    found = re.findall(whole, text)
    assert re.sub(whole, "", text).strip() == ""
    return [(kind, name, dict(re.findall(r"field\((\w+),\s*\"([^\"]*)\"\)", fields))) for kind, name, fields in found]


def protocols():
    """Body of every protocol, by name."""
    text = re.sub(r"#.*", "", (CONFIG / "piezod.proto").read_text(encoding="utf-8"))
    return dict(re.findall(r"^(\w+) \{(.*)\}$", text, re.MULTILINE))


def asked(fields):
    """Protocol and its argument."""
    match = re.fullmatch(r"@piezod\.proto (\w+)\((\w+)\) \$\(PORT\)", fields.get("INP") or fields.get("OUT"))
    return match.groups()


def test_records_name_protocols_that_are_there():
    assert len(records()) == 12
    assert {asked(fields)[0] for _, _, fields in records()} == set(protocols())
    for _, name, fields in records():
        assert len(fields["DESC"]) <= 40, name
        assert fields["DTYP"] == "stream"


@pytest.mark.parametrize(("kind", "name", "fields"), records(), ids=lambda one: one if isinstance(one, str) else "")
def test_what_a_record_reads_is_in_the_status_and_what_it_sends_is_a_command(kind, name, fields, tally):
    protocol, argument = asked(fields)
    sent, wanted = re.findall(r"'([^']*)'", protocols()[protocol])
    request = json.loads(sent.replace("$1", argument))
    assert request["command"] in COMMANDS
    if protocol == "command":
        assert json.dumps({"ok": True, "message": "arming"}).startswith(wanted)
        assert kind == "longout"
        return
    line = json.dumps({"ok": True, "age_s": 0.01, "stale": False} | tally.as_dict())
    before = re.match(r"%\*/(.*?)/", wanted)[1].replace("$1", argument)
    value = {"value": r"([-+0-9.eE]+)", "age": r"([-+0-9.eE]+)", "text": r"([^\"]{1,39})"}[protocol]
    found = re.search(before + value, line)
    assert found, (name, line)
    stale = re.search(before + value, line.replace('"stale": false', '"stale": true'))
    assert (stale is None) == (protocol == "value")
    assert kind == {"value": "ai", "age": "ai", "text": "stringin"}[protocol]
    if argument == "force_N":
        assert float(found[1]) == 12.5
    if argument == "state":
        assert found[1] == State.FAULT.name


def test_the_ophyd_device_reads_and_arms_in_its_own_simulation():
    """With mocked records, as ophyd-async offers; skipped where it is not installed."""
    core = pytest.importorskip("ophyd_async.core", reason="no ophyd-async here: pip install 'ophyd-async[ca]'")
    spec = importlib.util.spec_from_file_location("ophyd_piezod", CONFIG / "ophyd_piezod.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["ophyd_piezod"] = module
    spec.loader.exec_module(module)

    async def use():
        bench = module.PiezodBench("BENCH:", name="bench")
        await bench.connect(mock=True)
        core.set_mock_value(bench.force_N, 12.5)
        core.set_mock_value(bench.state, "RUNNING")
        await bench.stage()
        assert (await bench.read())["bench-force_N"]["value"] == 12.5
        await bench.unstage()
        core.set_mock_value(bench.state, "FAULT")
        with pytest.raises(RuntimeError, match="in FAULT"):
            await bench.stage()
        return {bench.force_N.source, bench.arm.source}

    assert asyncio.run(use()) == {"mock+ca://BENCH:FORCE", "mock+ca://BENCH:ARM.PROC"}


def test_the_ophyd_device_names_records_of_the_database():
    text = (CONFIG / "ophyd_piezod.py").read_text(encoding="utf-8")
    compile(text, "ophyd_piezod.py", "exec")
    suffixes = {suffix.partition(".")[0] for suffix in re.findall(r"PvSuffix\(\"([A-Z.]+)\"\)", text)}
    assert suffixes
    assert suffixes <= {name.removeprefix("$(P)") for _, name, _ in records()}


@pytest.fixture
def kept():
    """As a bench would be recorded: nanosecond ticks far from zero, a reading that is missing."""
    time_s = 1e5 + np.arange(500) * 1e-3
    force = np.sin(np.arange(500) / 20.0)
    force[17] = np.nan
    return Recording(time_s, {"voltage_V": np.arange(500.0), "force_N": force}, {"bench": "press"})


def test_plotjuggler_can_read_the_csv(kept, tmp_path):
    """One header, comma, a strictly increasing time column: what its CSV loader asks for."""
    write_recording(kept, tmp_path / "kept.csv")
    lines = [line for line in (tmp_path / "kept.csv").read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    assert lines[0] == "time_s,voltage_V,force_N"
    cells = [line.split(",") for line in lines[1:]]
    assert {len(row) for row in cells} == {3}
    times = [float(row[0]) for row in cells]
    assert all(b > a for a, b in pairwise(times))
    assert sum(not re.match(r"[-+0-9.]|nan", cell) for row in cells for cell in row) == 0


def test_matlab_can_read_the_mat_file(kept, tmp_path):
    """Version 5, plain double columns under names that are MATLAB's; scipy reads it as MATLAB would."""
    from scipy.io import loadmat

    write_recording(kept, tmp_path / "kept.mat")
    held = loadmat(tmp_path / "kept.mat")
    for name in ("time_s", "voltage_V", "force_N"):
        assert re.fullmatch(r"[A-Za-z]\w{0,62}", name)
        assert held[name].dtype == np.float64
        assert held[name].size == 500
    assert (np.diff(held["time_s"].ravel()) > 0).all()


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".h5", ".tdms", ".parquet", ".mf4", ".sqlite"])
def test_every_format_keeps_a_strictly_increasing_time(kept, tmp_path, suffix):
    write_recording(kept, tmp_path / "first.csv")
    convert(tmp_path / "first.csv", tmp_path / f"kept{suffix}")
    again = read_recording(tmp_path / f"kept{suffix}")
    assert (np.diff(again.time_s) > 0).all()
    assert again.time_s - again.time_s[0] == pytest.approx(kept.time_s - kept.time_s[0], abs=1e-9)
    assert load_recordings([tmp_path / f"kept{suffix}"], "voltage_V", "force_N")[0].recording.time_s.size == 500
