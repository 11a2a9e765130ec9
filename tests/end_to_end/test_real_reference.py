"""The recorded reference of a real stack, scaled to the bench's force range, followed through each wire."""

import json
from pathlib import Path

import pytest

from tests.benches.emulator import ROOT, bench_file, emulator, piezod

TRACKING = ROOT.parent / "shared" / "recordings" / "piezo-flexure" / "tracking.csv"


@pytest.mark.slow
@pytest.mark.skipif(not TRACKING.exists(), reason="the recordings in ../shared are not here")
@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_a_real_reference_is_followed_better_with_the_inverse_than_with_a_gain(wire, tmp_path):
    errors = {}
    for compensation in ("gain", "inverse"):
        with emulator("--time", "virtual", *(["--rtu"] if wire == "rtu" else ["--port", "0"])) as serves:
            folder = tmp_path / compensation
            folder.mkdir()
            bench = bench_file(
                folder,
                {wire: serves[wire]},
                rate_Hz=200,
                compensation=compensation,
                limits={"stale_after_ms": 20, "missed_ticks_in_a_row": 5},
                reference={
                    "kind": "file",
                    "path": str(TRACKING),
                    "column": "reference_um",
                    "scale": 5.0,
                    "offset_N": 150.0,
                },
            )
            done = piezod("run", bench, "--arm", "--json")
        assert done.returncode == 0, done.stderr
        result = json.loads(done.stdout)
        assert result["failed_exchanges"] == 0
        assert result["tracking"]["ticks"] > 14_000
        errors[compensation] = result["tracking"]
    print(Path(TRACKING).name, wire, errors)
    assert errors["inverse"]["rms_error_N"] < 0.25 * errors["gain"]["rms_error_N"]
