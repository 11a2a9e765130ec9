"""Limits that never act, or always, are refused; each of the others says when it acts."""

import pytest
import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.limits import LimitsConfig
from piezod.errors import ConfigurationError

POSITIVE = (
    "slew_V_per_s", "slew_down_V_per_s", "acceleration_V_per_s2", "deceleration_V_per_s2", "resonance_Hz",
    "current_max_A", "capacitance_F", "dissipation_max_W", "loss_tangent", "dissipation_over_s", "temperature_frozen_s",
    "force_rate_trip_N_per_s", "tracking_trip_N", "tracking_trip_ms", "readback_trip_V", "readback_trip_ms",
    "stuck_travel_V", "ramp_down_V_per_s", "stale_after_ms", "comm_loss_ms", "clamped_trip_ms", "arming_timeout_s",
)  # fmt: skip
SIGNED = (
    "voltage_min_V",
    "voltage_max_V",
    "temperature_trip_degC",
    "temperature_low_degC",
    "force_min_N",
    "force_trip_N",
)
NUMBERS = (
    "force_debounce_samples", "stuck_samples", "device_watchdog_ms", "missed_ticks_in_a_row", "failed_exchanges",
)  # fmt: skip
DAYS_11_MS = 950_400_000
ABSURD = [
    *((name, value) for name in POSITIVE for value in (1e-300, 1e300)),
    *((name, value) for name in SIGNED for value in (-1e300, 1e300)),
    *((name, value) for name in NUMBERS for value in (-1, 10**12)),
    ("voltage_step_V", -1e-300),
    ("voltage_step_V", 1e300),
    *((name, DAYS_11_MS) for name in ("stale_after_ms", "comm_loss_ms", "device_watchdog_ms", "tracking_trip_ms")),
]


def load(folder, **limits):
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    content["limits"] |= limits
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_bench(path)


def test_the_table_has_sixty_values_and_every_limit():
    assert len(ABSURD) >= 60
    assert {name for name, _ in ABSURD} == set(LimitsConfig.model_fields) - {"comm_loss_action", "output_on_in_status"}


@pytest.mark.parametrize(("name", "value"), ABSURD)
def test_an_absurd_limit_is_refused_in_one_line_that_names_it_and_its_bound(tmp_path, name, value):
    number = float(value) if name in (*POSITIVE, *SIGNED, "voltage_step_V") else value
    with pytest.raises(ConfigurationError, match=rf"limits\.{name} is .*, must be at (least|most) ") as refusal:
        load(tmp_path, **{name: number})
    assert refusal.value.exit_code == 78
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "acts", "never"),
    [
        ("acceleration_V_per_s2", 7.9e6, 8.1e6),  # two slews of 4,000 V/s within 1 ms
        ("deceleration_V_per_s2", 7.9e6, 8.1e6),
        ("force_rate_trip_N_per_s", 1.9e7, 2.1e7),  # -1,000 to 1,000 N, the range of the register, in a tenth of a tick
        ("tracking_trip_N", 1999.0, 2001.0),
        ("stuck_travel_V", 139.0, 141.0),
    ],
)
def test_a_limit_that_nothing_can_reach_must_be_null(tmp_path, name, acts, never):
    assert getattr(load(tmp_path, **{name: acts}).limits, name) == acts
    with pytest.raises(ConfigurationError, match=rf"limits\.{name} is .* it can never act; lower it, or write null"):
        load(tmp_path, **{name: never})
    without = {"stuck_samples": None} if name == "stuck_travel_V" else {}
    assert load(tmp_path, **({name: never} | without if without else {name: None}))


def test_every_limit_says_when_it_acts(tmp_path):
    acts = load(tmp_path).limits.acts_after
    assert set(acts) == {name for name, _ in ABSURD}
    assert acts["comm_loss_ms"] == "200, acts after this time"
    assert acts["acceleration_V_per_s2"] == "null"
