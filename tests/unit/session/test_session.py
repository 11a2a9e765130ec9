"""A session before its control process runs."""

from pathlib import Path

from piezod.config import load_bench
from piezod.session.session import Session
from piezod.session.task import Task

CONFIG = Path(__file__).parents[3] / "config"


def test_a_stop_before_the_control_process_runs_is_kept_and_signals_nobody(tmp_path):
    session = Session(Task(load_bench(CONFIG / "bench.yaml"), None, tmp_path, ()), None)
    session.stop()
    assert session._stop_requested
