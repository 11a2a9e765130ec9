"""Every invalid bench file is refused with one line that names file, line, key, value and limit."""

from pathlib import Path

import pytest

from piezod.config import load_bench
from piezod.config.limits import loosened_limit
from piezod.errors import ConfigurationError

BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"

REFUSED = [
    # text of the shipped file, its replacement, part of the message
    ("slew_V_per_s: 4000.0", "slew_V_per_s: -3.0", "limits.slew_V_per_s is -3.0, must be at least 0.1"),
    ("slew_V_per_s: 4000.0", "slow_V_per_s: 4000.0", "unknown key limits.slow_V_per_s, did you mean 'slew_V_per_s'?"),
    ("slew_V_per_s: 4000.0", "slew_V_per_s: 40000.0", "must be at most current_max_A / capacitance_F = 6000"),
    ("rate_Hz: 1000", "rate_Hz: .nan", "rate_Hz is nan, must be a finite number"),
    ("rate_Hz: 1000", "rate_Hz: .inf", "rate_Hz is inf, must be a finite number"),
    ("rate_Hz: 1000", "rate_Hz: true", "rate_Hz is true, must be a number"),
    ("rate_Hz: 1000", "rate_Hz: 12:30", "rate_Hz is '12:30', must be a number"),
    ("rate_Hz: 1000", "rate_Hz: '1000'", "rate_Hz is '1000', must be a number"),
    ("port: 15020", "port: 0400", "link.port is '0400', must be a whole number"),
    ("rate_Hz: 1000", "rate_Hz: 1000\nrate_Hz: 2000", "key 'rate_Hz' appears twice, first on line"),
    ("kind: triangle", "kind: triangel", "reference.kind is 'triangel', must be one of 'triangle'"),
    ("kind: modbus_tcp", "kind: modbus", "must be one of 'modbus_tcp', 'modbus_rtu', 'rtu_over_tcp'"),
    ("unit: N, low", "unit: kN, low", "force.unit is 'kN', must be 'N'; convert with scale and offset"),
    ("  voltage_max_V: 140.0\n", "", "limits.voltage_max_V is missing"),
    ("voltage_min_V: 0.0 ", "voltage_min_V: 150.0 ", "voltage_min_V is 150, must be below voltage_max_V, 140"),
    ("device_watchdog_ms: 100", "device_watchdog_ms: 200", "device_watchdog_ms is 200, must be below comm_loss_ms"),
    ("device_watchdog_ms: 100", "device_watchdog_ms: 2", "device_watchdog_ms is 2, must be above two ticks, 2 ms"),
    ("stale_after_ms: 5", "stale_after_ms: 500", "stale_after_ms is 500, must be at most comm_loss_ms, 200"),
    ("force_min_N: -20.0", "force_min_N: 400.0", "force_min_N is 400, must be below force_trip_N, 360"),
    ("voltage_V_per_s: 200", "voltage_V_per_s: 9000", "arming.voltage_V_per_s is 9000, must be at most limits.slew"),
    ("schema: piezod.bench/1", "schema: piezod.bench/9", "schema is 'piezod.bench/9', must be 'piezod.bench/1'"),
    ("host: 127.0.0.1", "host: [1", "not valid YAML"),
    ("host: 127.0.0.1", "host: &a x\n  port2: *a", "uses an alias"),
    ("voltage_step_V: 0.0 ", "voltage_step_V: 0.3 ", "voltage_step_V is 0.3, must be at most one tick of arming."),
    ("    watchdog_ms: {", "    voltage_x: {", "unknown key link.registers.voltage_x"),
    ("    watchdog_ms: {address: 110, function: 16, type: uint16, unit: ms}\n", "", "but the link has no watchdog_ms"),
    ("name: emulator ", "name: ../../etc ", "name is '../../etc'"),
    ("slew_down_V_per_s: null", "slew_down_V_per_s: 7000", "slew_down_V_per_s is 7000, must be at most current_max_A"),
    ("ramp_down_V_per_s: 400.0", "ramp_down_V_per_s: 4500.0", "ramp_down_V_per_s is 4500, must be at most slew"),
    ("resonance_Hz: 200.0", "resonance_Hz: 10.0", "resonance_Hz is 10, but the range can be crossed in 35 ms"),
    ("loss_tangent: 0.02 ", "loss_tangent: null ", "loss_tangent is missing: give both dissipation_max_W and"),
    ("    temperature:  ", "    #", "limits.temperature_trip_degC is 70, but the link reads no temperature"),
    ("    voltage_readback: ", "    #", "limits.readback_trip_V is 3, but the link reads no voltage_readback"),
    ("low: -1000, high: 1000", "low: -1000, high: 300", "force_trip_N is 360, must be below registers.force.high, 300"),
    ("low: -1000, high: 1000", "low: -10, high: 1000", "force_min_N is -20, must be above registers.force.low, -10"),
    ("stale_after_ms: 5 ", "stale_after_ms: 0.5 ", "stale_after_ms is 0.5, must be at least one tick, 1 ms"),
    ("step_V: 2.0", "step_V: 200.0", "arming.sign_check.step_V is 200, must be at most 140"),
    ("force_debounce_samples: 2", "force_debounce_samples: 0", "force_debounce_samples is 0, must be at least 1"),
    ("  without: []", "  without: [watchdog]", "arming.without.0 is 'watchdog', must be 'identity'"),
    ("socket_mode: '0660'", "socket_mode: '999'", "daemon.socket_mode is '999'"),
    ("host: 127.0.0.1", "host: bench 3", "no host has the name 'bench 3': it contains a space"),
    ("host: 127.0.0.1", "host: bench..lan", "no host has the name 'bench..lan': a part between two points is empty"),
    ("host: 127.0.0.1", "host: 127.0.0.1:502", "no host has the name '127.0.0.1:502': write the number behind ':' as"),
    ("host: 127.0.0.1", "host: 'http://bench'", "write the name alone, without a protocol or a path"),
    ("host: 127.0.0.1", "host: 192.168.1.300", "an address has four numbers from 0 to 255"),
    ("host: 127.0.0.1", "host: -bench", "the part '-bench' may hold letters, digits and inner hyphens only"),
    ("host: 127.0.0.1", f"host: {'a.' * 127}", "it has 254 characters, must have at most 253"),
    ("host: 127.0.0.1", f"host: {'a' * 64}.lan", "the part aaaaaaaa... has 64 characters, must have at most 63"),
    ("cpu: null", "cpu: 100000", "real_time.cpu is 100000, must be at most"),
    ("host: 127.0.0.1", "host: 8.8.8.8", "set tls, or set allow_plaintext_remote: true"),
    ("host: 127.0.0.1", "host: '2001:4860:4860::8888'", "is the routable address 2001:4860:4860::8888"),
    ("tls: null", "tls: {ca: ca.pem, certificate: /c, key: /k}", "link.tls.ca is 'ca.pem'"),
    ("recorder: null", "recorder: {folder: /x, sync_every_s: 20.0}", "daemon.ring_seconds is 60, must be at least"),
    ("recorder: null", "recorder: {folder: /x, folder_MB: 500.0}", "folder_MB is 500, must be at least two files of"),
]  # fmt: skip


def refused(tmp_path, old, new):
    """The error message after replacing `old` by `new` in the shipped configuration."""
    text = BENCH.read_text(encoding="utf-8")
    assert text.count(old) >= 1
    path = tmp_path / "bench.yaml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_bench(path)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 78
    return str(caught.value).replace(str(path), "bench.yaml")


def line_of(text):
    return BENCH.read_text(encoding="utf-8").splitlines().index(text) + 1


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("force_trip_N: 360.0", "force_trip_N: 3600.0", "force_trip_N"),
        ("voltage_V_per_s: 200", "voltage_V_per_s: 9000", "voltage_V_per_s: 9000"),
        ("step_V: 2.0", "step_V: 200.0", "step_V"),
        ("slew_down_V_per_s: null", "slew_down_V_per_s: 7000", "slew_down_V_per_s"),
        ("device_watchdog_ms: 100", "device_watchdog_ms: 2", "device_watchdog_ms"),
        ("unit: N, low", "unit: kN, low", "force:"),
        ("cpu: null", "cpu: 100000", "cpu:"),
        ("host: 127.0.0.1", "host: bench 3", "host:"),
    ],
)
def test_a_message_names_the_line_of_the_key_that_it_is_about(tmp_path, old, new, key):
    lines = BENCH.read_text(encoding="utf-8").replace(old, new, 1).splitlines()
    expected = next(number for number, line in enumerate(lines, 1) if line.lstrip().startswith(key))
    assert refused(tmp_path, old, new).startswith(f"bench.yaml:{expected}: ")


@pytest.mark.parametrize(
    "host", ["::1", "fe80::1%eth0", "bench", "bench.lab.lan.", "press_3.lan", "b\u00fccher.example"]
)
def test_a_possible_host_is_accepted(tmp_path, host):
    path = tmp_path / "bench.yaml"
    text = BENCH.read_text(encoding="utf-8").replace("host: 127.0.0.1", f"host: '{host}'", 1)
    path.write_text(text, encoding="utf-8")
    assert load_bench(path).link.host == host


def test_the_shipped_configuration_is_accepted():
    assert load_bench(BENCH).rate_Hz == 1000


@pytest.mark.parametrize(("old", "new", "message"), REFUSED)
def test_an_impossible_value_is_refused_in_one_line(tmp_path, old, new, message):
    assert message in refused(tmp_path, old, new)


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"force_trip_N": 361.0}, "force_trip_N"),
        ({"force_min_N": -21.0}, "force_min_N"),
        ({"voltage_max_V": 141.0}, "voltage_max_V"),
        ({"tracking_trip_N": None}, "tracking_trip_N"),
        ({"ramp_down_V_per_s": 300.0}, "ramp_down_V_per_s"),
        ({"device_watchdog_ms": 90}, "device_watchdog_ms"),
        ({"comm_loss_action": "hold"}, "comm_loss_action"),
        ({"slew_down_V_per_s": 3000.0}, "slew_down_V_per_s"),
    ],
)
def test_a_limit_that_is_looser_or_not_comparable_is_named(changes, names):
    limits = load_bench(BENCH).limits
    assert f"limits.{names} " in loosened_limit(limits, limits.model_copy(update=changes))


@pytest.mark.parametrize(
    "changes",
    [{}, {"force_trip_N": 300.0, "force_min_N": -10.0}, {"slew_V_per_s": 100.0}, {"missed_ticks_in_a_row": 4}],
)
def test_tighter_limits_are_accepted_while_armed(changes):
    limits = load_bench(BENCH).limits
    assert loosened_limit(limits, limits.model_copy(update=changes)) == ""


@pytest.mark.parametrize(
    ("host", "more"),
    [
        ("127.0.0.1", ""),
        ("192.168.1.207", ""),
        ("fe80::1%eth0", ""),
        ("bench.example.org", ""),
        ("8.8.8.8", "allow_plaintext_remote: true"),
        ("8.8.8.8", "tls: {ca: /ca, certificate: /c, key: $CREDENTIALS_DIRECTORY/k}"),
    ],
)
def test_plain_modbus_is_accepted_for_a_local_host_and_otherwise_only_on_request(tmp_path, host, more):
    text = BENCH.read_text(encoding="utf-8").replace("host: 127.0.0.1", f"host: '{host}'\n  {more}", 1)
    key = more.partition(":")[0]
    lines = [line for line in text.splitlines() if not (key and line.startswith(f"  {key}: ") and more not in line)]
    path = tmp_path / "bench.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    assert load_bench(path).link.host == host


def test_the_message_names_the_line(tmp_path):
    text = "  slew_V_per_s: 4000.0          # at most current_max_A / capacitance_F"
    assert refused(tmp_path, "slew_V_per_s: 4000.0", "slew_V_per_s: 0.0").startswith(f"bench.yaml:{line_of(text)}: ")


def test_registers_of_one_block_may_not_overlap(tmp_path):
    assert "heartbeat.address is 203, must be at least 204" in refused(tmp_path, "{address: 204", "{address: 203")
