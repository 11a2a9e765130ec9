"""The bundle of a running daemon holds its log."""

import zipfile

from tests.benches.daemon import LONG_LIMITS, daemon
from tests.benches.emulator import bench_file, emulator, piezod


def test_the_bundle_of_a_running_daemon_holds_its_log(tmp_path):
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100, limits=LONG_LIMITS)
        with daemon(bench) as service:
            service.connected()
            service.tell("disarm")
            done = piezod("support-bundle", bench, "-o", tmp_path / "out.zip")
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "out.zip") as bundle:
        lines = bundle.read("log.txt").decode().splitlines()
    assert any("reading only; arm with" in line for line in lines)
    assert any("socket: disarm by uid" in line for line in lines)
    assert [line.partition(" ")[0] for line in lines] == sorted(line.partition(" ")[0] for line in lines)
