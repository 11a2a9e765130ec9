"""`piezod run` learns a looped reference from one repeat to the next, beside an emulated bench with friction."""

import re

import pytest
import yaml

from tests.benches.daemon import LONG_LIMITS, daemon
from tests.benches.emulator import EMULATOR, bench_file, emulator, piezod

REFERENCE = {"kind": "triangle", "amplitude_N": 100.0, "offset_N": 150.0, "frequency_Hz": 1.0, "duration_s": None}
HIDDEN = {"friction": {"force_N": 5.0, "presliding_N": 4.0}}
LIMITS = LONG_LIMITS | {"tracking_trip_N": None}


def learned(service, least_passes):
    """What the status says of the learning after a number of passes."""
    state = {"passes": 0}

    def has_learned():
        state.update(service.status()["learning"] or {})
        return state["passes"] >= least_passes

    service.wait_until(has_learned, f"{least_passes} passes")
    return state


@pytest.fixture
def bench(tmp_path):
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"seed": 3, "effects": HIDDEN}
    (tmp_path / "emulator.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with emulator("--time", "virtual", "--port", "0", config=tmp_path / "emulator.yaml") as serves:
        yield bench_file(
            tmp_path,
            serves,
            rate_Hz=200,
            limits=LIMITS,
            arming={"voltage_V_per_s": 800.0, "without": ["sign_check"]},  # friction hides the rise of its small step
            reference=REFERENCE,
            learning={},
            drift=None,
        )


def test_the_error_falls_from_repeat_to_repeat_and_the_next_start_goes_on(bench):
    with daemon(bench) as service:
        service.connected().command("arm")
        first = learned(service, 7)
        assert first["state"] == "learning"
        assert first["rms_N"] < 0.3 * first["first_N"]
        assert re.search(r"learning: error \S+ N at first, \S+ N in pass \d+\n", service.command("status").stdout)
    assert (bench.parent / "ring.learned.csv").exists()
    with daemon(bench) as service:
        service.connected().command("arm")
        again = learned(service, 2)
        assert again["first_N"] < 0.5 * first["first_N"]
        service.wait_for("learning: starts from")


def test_a_reference_that_ends_cannot_be_learned(bench):
    content = yaml.safe_load(bench.read_text(encoding="utf-8"))
    content["reference"]["duration_s"] = 5.0
    bench.write_text(yaml.safe_dump(content), encoding="utf-8")
    done = piezod("run", bench)
    assert done.returncode == 78
    assert "learning needs a reference that repeats" in done.stderr
