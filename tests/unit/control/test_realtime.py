"""Settings of the operating system: what a refused right leaves, and what is undone."""

import ctypes
import os

import pytest

from piezod.config import RealTimeConfig
from piezod.control import real_time, realtime
from piezod.control.realtime import RealTimeWarning

PR_GET_TIMERSLACK = 30


def slack_ns():
    return ctypes.CDLL(None).prctl(PR_GET_TIMERSLACK)


def test_without_fifo_the_timer_slack_is_one_nanosecond_and_is_restored():
    before_ns = slack_ns()
    assert before_ns > 1
    with real_time(RealTimeConfig(fifo_priority=0, lock_memory=False, hold_cpu_latency=False)):
        assert slack_ns() == 1
    assert slack_ns() == before_ns


def test_a_refused_fifo_warns_and_sets_the_timer_slack(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, _: policy == os.SCHED_FIFO and refuse())
    config = RealTimeConfig(fifo_priority=80, lock_memory=False, hold_cpu_latency=False)
    with pytest.warns(RealTimeWarning, match=r"real_time\.fifo_priority"), real_time(config):
        assert slack_ns() == 1


def test_the_request_for_a_latency_of_zero_is_written_before_the_loop_runs(tmp_path, monkeypatch):
    asked = tmp_path / "cpu_dma_latency"
    asked.write_bytes(b"")
    monkeypatch.setattr(realtime, "_DMA_LATENCY", asked)
    with real_time(RealTimeConfig(fifo_priority=0, lock_memory=False, hold_cpu_latency=True)):
        assert asked.read_bytes() == bytes(4)


def test_the_cores_of_the_process_are_restored(monkeypatch):
    before = os.sched_getaffinity(0)
    with real_time(RealTimeConfig(fifo_priority=0, lock_memory=False, hold_cpu_latency=False, cpu=min(before))):
        assert os.sched_getaffinity(0) == {min(before)}
    assert os.sched_getaffinity(0) == before
