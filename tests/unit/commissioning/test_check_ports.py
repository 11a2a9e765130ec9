"""A serial port that the service may not open is reported with the drop-in that allows it."""

import pytest

from piezod.commissioning.check import check_ports
from piezod.config import load_bench
from tests.benches.emulator import bench_file


@pytest.mark.parametrize(("port", "count"), [("/dev/ttymxc2", 1), ("/dev/ttyUSB0", 0)])
def test_a_port_that_the_service_may_not_open_is_reported(tmp_path, port, count):
    checks = list(check_ports(load_bench(bench_file(tmp_path, {"rtu": port}))))
    assert len(checks) == count
    for check in checks:
        assert check.level == "WARN"
        assert "DeviceAllow=/dev/ttymxc2 rw" in check.remedy
