"""A configuration that is read again: when it is answered, when it is refused, and which one the next session gets."""

import asyncio
import shutil
from typing import ClassVar

import numpy as np
import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.reference import FileReference
from piezod.control import ROW_DTYPE, State
from piezod.daemon import service as service_module
from piezod.daemon.file_reader import load_bench_files
from piezod.daemon.reload import check_armed_change
from piezod.daemon.service import Service
from piezod.errors import CheckFailedError, TemporaryError
from piezod.session.files import files_digest


class Channel:
    """A channel that answers every command with "ok" and lists it."""

    counters = ()
    bad_exchange = None

    def __init__(self, session):
        self.session, self.connected, self.ended, self.problem = session, True, False, ""
        self.sent = []
        self.refuses = None

    async def send(self, name, argument=None, *, settle_s, requested_ns=None):
        self.sent.append((name, argument))
        if self.refuses is not None:
            raise self.refuses
        return name


class QuietSession:
    dropped = 0

    def read(self):
        return np.empty(0, ROW_DTYPE)


class LaunchedSession:
    launched: ClassVar[list] = []

    def __init__(self, task, *_, **more):
        self.bench, self.heat_W = task.bench, task.heat_W

    def launch(self):
        self.launched.append(self)


@pytest.fixture
def path(tmp_path):
    for name in ("bench.yaml", "model.yaml"):
        shutil.copy(shipped("bench.yaml").with_name(name), tmp_path / name)
    return tmp_path / "bench.yaml"


@pytest.fixture
def service(path, monkeypatch):
    async def read(path):
        return load_bench_files(path)

    monkeypatch.setattr(service_module, "read_bench_files", read)
    monkeypatch.setattr(service_module, "Session", LaunchedSession)
    LaunchedSession.launched.clear()
    made = Service(path, load_bench(path), None, QuietSession(), arm=False)
    made._channel = Channel(QuietSession())
    made._files = files_digest(made._bench, path)
    return made


def reload(service):
    return asyncio.run(asyncio.wait_for(service._reload(), 2.0))


def edit(path, old="force_trip_N: 360.0", new="force_trip_N: 100.0"):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.mark.parametrize(("connected", "ended"), [(False, False), (True, True)])
def test_a_reload_is_refused_while_a_control_process_starts_or_ends(service, path, connected, ended):
    service._channel.connected, service._channel.ended = connected, ended
    edit(path)
    with pytest.raises(TemporaryError, match="with the former configuration"):
        reload(service)
    assert service._bench.limits.force_trip_N == 360.0
    service._channel.connected, service._channel.ended = True, False
    service.statistics._state = service_module.State.RUNNING
    assert reload(service) == "limits"  # not "nothing has changed"
    assert service._channel.sent[-1][1].force_trip_N == 100.0


def test_without_a_control_process_the_next_one_gets_the_configuration(service, path):
    service._channel.session = None
    edit(path)
    assert reload(service).startswith("configuration taken")
    service._launch()
    assert LaunchedSession.launched[-1].bench.limits.force_trip_N == 100.0


def test_a_disarmed_bench_is_answered_after_the_launch_of_the_next_control_process(service, path):
    edit(path)
    service.outcome.heat_W = 1.5

    async def scenario():
        reload = asyncio.create_task(service._reload())
        await asyncio.sleep(0.01)
        assert service._channel.sent == [("end", None)]
        assert not reload.done()
        assert service._bench.limits.force_trip_N == 360.0
        service._launch()
        return await reload

    assert asyncio.run(scenario()) == "configuration taken; starting again, disarmed"
    assert service._bench.limits.force_trip_N == 100.0
    (launched,) = LaunchedSession.launched
    assert (launched.bench.limits.force_trip_N, launched.heat_W) == (100.0, 1.5)


def test_a_refused_end_leaves_the_former_configuration(service, path):
    edit(path)
    service._channel.refuses = CheckFailedError("end: state is ARMING")
    with pytest.raises(CheckFailedError, match="ARMING"):
        reload(service)
    assert service._next is None
    assert service._bench.limits.force_trip_N == 360.0


def test_limits_that_the_control_process_has_not_taken_are_not_the_present_ones(service, path):
    service.statistics._state = service_module.State.RUNNING
    service._channel.refuses = TemporaryError("limits: the control process did not answer")
    edit(path)
    with pytest.raises(TemporaryError):
        reload(service)
    assert service._bench.limits.force_trip_N == 360.0


def test_another_model_or_reference_file_counts_as_a_change(service, path):
    assert reload(service) == "nothing has changed"
    model = path.with_name("model.yaml")
    model.write_text(model.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    service.statistics._state = service_module.State.RUNNING
    with pytest.raises(CheckFailedError, match="only limits may change"):
        reload(service)
    bench = load_bench(path)
    table = path.with_name("table.csv")
    followed = bench.model_copy(update={"reference": FileReference(kind="file", path=table.name)})
    table.write_text("time_s,reference_N\n0,1\n", encoding="utf-8")
    before = files_digest(followed, path)
    table.write_text("time_s,reference_N\n0,2\n", encoding="utf-8")
    assert files_digest(followed, path) != before


@pytest.mark.parametrize(("state", "advice"), [(State.FAULT, "piezod reset first"), (State.RUNNING, "disarm first")])
@pytest.mark.parametrize("change", [{"force_trip_N": 1e6}, None], ids=["looser", "rate"])
def test_a_refused_change_says_what_comes_first_in_this_state(path, state, advice, change):
    bench = load_bench(path)
    changed = {"rate_Hz": 100.0} if change is None else {"limits": bench.limits.model_copy(update=change)}
    with pytest.raises(CheckFailedError, match=f"while {state.name} .*; {advice}$"):
        check_armed_change(bench, bench.model_copy(update=changed), state, is_other_file=False)
