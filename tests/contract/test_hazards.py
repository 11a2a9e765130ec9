"""The hazard list of systemd/README.md, the limits of a bench file, and the injected faults name each other."""

import re
from pathlib import Path

import pytest
import yaml

from piezod.commissioning.proof import STEPS
from piezod.commissioning.proof.coverage import TRIPS
from piezod.config import BenchConfig
from piezod.config.limits import LimitsConfig
from piezod.config.link import ModbusTcpLink, Registers
from piezod.config.reference import StreamReference
from piezod.config.sections import ArmingConfig

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "systemd" / "README.md").read_text(encoding="utf-8")
FAULTS = {
    fault["id"]: fault for fault in yaml.safe_load((ROOT / "tests/faults/faults.yaml").read_text("utf-8"))["faults"]
}
HAZARDS = (
    "over-voltage", "over-force", "jump after a pause", "tension", "overheating", "wrong polarity", "wrong device",
    "stale or forged data", "lost watchdog", "operator's error", "two masters", "software hang", "power cut",
)  # fmt: skip
SECTIONS = {"arming": ArmingConfig, "link": ModbusTcpLink, "reference": StreamReference, "registers": Registers}
TRIPPING = {  # text of the latched cause
    "force_trip_N": "force above limits.force_trip_N",
    "force_min_N": "force below limits.force_min_N",
    "force_rate_trip_N_per_s": "force changed faster than limits.force_rate_trip_N_per_s",
    "tracking_trip_N": "limits.tracking_trip_N",
    "readback_trip_V": "the voltage read back is not the voltage written",
    "stuck_samples": "equal force readings while the voltage moved",
    "dissipation_max_W": "limits.dissipation_max_W",
    "temperature_trip_degC": "temperature above limits.temperature_trip_degC",
    "comm_loss_ms": "no good exchange for limits.comm_loss_ms",
    "stale_after_ms": "no good exchange for limits.comm_loss_ms",
    "device_watchdog_ms": "the watchdog of the device was changed",
    "temperature_low_degC": "the temperature is missing, below limits.temperature_low_degC",
    "output_on_in_status": "the device reports its output as off",
    "clamped_trip_ms": "the device reports a clamped output",
    "failed_exchanges": "too many failed exchanges",
    "missed_ticks_in_a_row": "too many ticks missed in a row",
}


class Row:
    """One line of the table."""

    def __init__(self, line):
        self.hazard, self.cause, self.interlock, self.safe_state, self.proof = (
            cell.strip() for cell in line.strip("|").split("|")
        )

    @property
    def keys(self):
        return re.findall(r"`([a-zA-Z_][a-zA-Z_0-9.]*)`", self.interlock)

    @property
    def faults(self):
        return re.findall(r"\b[TPMVCRDS][0-9]{1,2}\b", self.proof)

    @property
    def tests(self):
        return re.findall(r"`(tests/[^`]*)`", self.proof)

    @property
    def steps(self):
        return re.findall(r"step `([a-z]+)`", self.proof)

    @property
    def reason(self):
        """Why no step of the proof test proves this line."""
        found = re.search(r"none: ([^|]+)", self.proof)
        return found[1].strip() if found else ""


ROWS = [Row(line) for line in TEXT.splitlines() if re.match(r"\| H[0-9]+ ", line)]


def exists(key):
    """Whether a key of the bench file exists; without a section it belongs to `limits`."""
    if "." not in key:
        return key in LimitsConfig.model_fields or key in BenchConfig.model_fields
    *path, name = key.split(".")
    return name in SECTIONS[path[-1]].model_fields


def test_the_list_has_every_hazard_once_and_in_order():
    named = [match[2] for row in ROWS if (match := re.match(r"H([0-9]+) (.+)", row.hazard))]
    assert tuple(named) == HAZARDS
    numbers = [int(re.match(r"H([0-9]+)", row.hazard)[1]) for row in ROWS]
    assert numbers == sorted(numbers)
    assert set(numbers) == set(range(1, len(HAZARDS) + 1))


def test_every_limit_is_named_in_a_hazard():
    named = {key for row in ROWS for key in row.keys}
    assert [key for key in LimitsConfig.model_fields if key not in named] == []


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.hazard}: {row.cause}"[:60])
def test_a_hazard_names_existing_keys_faults_tests_and_steps_and_has_a_safe_state(row):
    assert [key for key in row.keys if not exists(key)] == []
    assert [name for name in row.faults if name not in FAULTS] == []
    assert [name for name in row.tests if not (ROOT / name).is_file()] == []
    assert [name for name in row.steps if name not in STEPS] == []
    assert row.faults
    assert row.safe_state


@pytest.mark.parametrize("key", TRIPPING)
def test_a_fault_of_the_row_of_a_trip_latches_it(key):
    found = [FAULTS[name] for row in ROWS if key in row.keys for name in row.faults]
    assert any(
        "FAULT" in (fault["expect"].get("state") or "") and TRIPPING[key] in (fault.get("logged") or "")
        for fault in found
    )


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.hazard}: {row.cause}"[:60])
def test_a_hazard_names_its_step_of_the_proof_test_or_the_reason_why_none_proves_it(row):
    assert bool(row.steps) != bool(row.reason)


@pytest.mark.parametrize("trip", TRIPS, ids=lambda trip: trip.key)
def test_a_trip_of_the_coverage_has_a_step_or_a_reason_and_its_hazard_names_the_step(trip):
    assert bool(trip.step) != bool(trip.reason)
    assert trip.step in {"", *STEPS}
    name = "status register" if trip.key == "link.registers.status" else f"`{trip.key}`"
    named = [row for row in ROWS if name in row.interlock]
    assert named
    assert not trip.step or any(trip.step in row.steps for row in named)


@pytest.mark.parametrize("key", TRIPPING)
def test_every_limit_that_trips_belongs_to_the_coverage(key):
    assert key in {trip.key for trip in TRIPS}


def test_every_step_of_the_proof_test_proves_a_hazard_and_has_an_interval():
    assert set(STEPS) == {name for row in ROWS for name in row.steps}
    for name in STEPS:
        assert re.search(rf"^\| [^|]*`{name}`[^|]* \|.*(monthly|weekly)", TEXT, re.MULTILINE), name


def test_the_list_is_short_enough_to_read():
    assert len(TEXT.encode()) < 25_000
