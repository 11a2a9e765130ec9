"""`piezod run --sequence` on the emulated bench in virtual time."""

import json
import xml.etree.ElementTree as ET

import pytest
import yaml

from piezod.errors import CheckFailedError, PiezodError
from tests.benches.emulator import bench_file, emulator, piezod


def step(name="slow", limits=None, **changes):
    reference = {"kind": "triangle", "amplitude_N": 40.0, "offset_N": 150.0, "frequency_Hz": 0.5, "duration_s": 6.0}
    return {"name": name, "reference": reference | changes, "limits": limits or {"rms_error_N": 0.5, "missed_ticks": 0}}


def sequence_file(folder, *steps):
    path = folder / "test.yaml"
    path.write_text(yaml.safe_dump({"schema": "piezod.sequence/1", "name": "test", "steps": list(steps)}))
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequence")
    with emulator("--time", "virtual", "--port", "0") as serves:
        yield bench_file(folder, serves, rate_Hz=200, limits={"stale_after_ms": 20})


def test_a_sequence_is_judged_and_has_junit_page_and_recordings(bench, tmp_path):
    path = sequence_file(tmp_path, step(), step("tight", {"max_error_N": 0.001}, amplitude_N=20.0))
    out = tmp_path / "out"
    done = piezod("run", bench, "--sequence", path, "--arm", "-o", out, "--json")
    assert done.returncode == 1, done.stderr
    result = json.loads(done.stdout)
    assert [limit["result"] for one in result["steps"] for limit in one["limits"]] == ["passed", "passed", "failed"]
    assert result["steps"][0]["duration_s"] == pytest.approx(6.0, abs=0.1)
    assert ET.parse(out / "junit.xml").getroot().get("failures") == "1"
    assert sorted(one.name for one in out.glob("*.csv")) == ["step_1.csv", "step_2.csv"]
    assert "tight" in (out / "sequence.html").read_text(encoding="utf-8")


def test_a_passing_sequence_ends_with_0(bench, tmp_path):
    done = piezod("run", bench, "--sequence", sequence_file(tmp_path, step()), "--arm", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "test passed: 2 limits of 1 steps are kept" in done.stdout


class Killed(BaseException):
    """What no handler of the command catches, as SIGKILL."""


@pytest.mark.parametrize(
    ("steps", "error", "left"),
    [([step()], Killed, ["junit.xml"]), ([step(offset_N=330.0)], CheckFailedError, [])],
)
def test_a_run_that_does_not_end_leaves_no_result_of_the_run_before(bench, tmp_path, monkeypatch, steps, error, left):
    from piezod.cli.running import _run_sequence
    from piezod.commissioning import sequence

    def killed(*_):
        raise Killed

    out = tmp_path / "out"
    out.mkdir()
    for name in ("junit.xml", "sequence.html", "step_1.csv", "step_2.csv"):
        (out / name).write_text('<testsuites failures="0"/>')
    monkeypatch.setattr(sequence, "run_sequence", killed)
    with pytest.raises(error):
        _run_sequence(bench, sequence_file(tmp_path, *steps), out, arm=True, force=True, as_json=False)
    assert [one.name for one in out.iterdir()] == left
    assert [ET.parse(out / name).getroot().get("failures") for name in left] == ["3" for _ in left]


def test_without_arm_a_sequence_is_only_checked(bench, tmp_path):
    path = sequence_file(tmp_path, step())
    done = piezod("run", bench, "--sequence", path)
    assert done.returncode == 0, done.stderr
    assert "1 steps, about" in done.stdout
    assert "not driven, --arm is not given" in done.stdout
    assert f"piezod run {bench} --sequence {path} --arm -o test-result" in done.stdout


@pytest.mark.parametrize(
    ("bad", "code", "says"),
    [
        (
            step(offset_N=330.0),
            1,
            "not driven, step 'slow', reference: 290 to 370 N, must be within limits.force_min_N",
        ),
        (step(offset_N=3000.0), 1, "not driven, step 'slow', reference: "),
        (step(limits={"rms_error_N": -1.0}), 78, "steps.0.limits.rms_error_N is -1.0, must be at least 0"),
    ],
)
def test_a_step_that_cannot_be_driven_is_one_line_and_no_session_is_started(bench, tmp_path, bad, code, says):
    done = piezod(
        "run", bench, "--sequence", sequence_file(tmp_path, step("good"), bad), "--arm", "-o", tmp_path / "out"
    )
    assert done.returncode == code
    assert says.replace("steps.0", "steps.1") in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_no_voltage_is_written_where_a_check_of_the_bench_fails(tmp_path, monkeypatch):
    """Nobody answers at the address: the device checks fail, and nothing drives."""
    from piezod.commissioning import sequence

    def forbidden(*_args, **_more):
        raise AssertionError("the bench was driven")

    monkeypatch.setattr(sequence, "drive", forbidden)
    config = bench_file(tmp_path, {"tcp": "127.0.0.1:1"}, rate_Hz=200, limits={"stale_after_ms": 20})
    with pytest.raises(CheckFailedError, match="not driven"):
        sequence.plan_sequence(config, sequence_file(tmp_path, step()))


def test_a_file_reference_starts_from_the_folder_of_the_sequence(bench, tmp_path):
    from piezod.commissioning.sequence import plan_sequence

    (tmp_path / "force.csv").write_text("time_s,reference_N\n0.0,100.0\n1.0,120.0\n2.0,100.0\n", encoding="utf-8")
    made = step() | {"reference": {"kind": "file", "path": "force.csv"}}
    assert plan_sequence(bench, sequence_file(tmp_path, made)).ticks == (401,)
    with pytest.raises(PiezodError, match=r"missing\.csv"):
        plan_sequence(bench, sequence_file(tmp_path, made | {"reference": {"kind": "file", "path": "missing.csv"}}))


def test_the_options_of_a_sequence_belong_together(bench, tmp_path):
    done = piezod("run", bench, "--sequence", sequence_file(tmp_path, step()), "--arm")
    assert (done.returncode, done.stderr) == (
        2, "piezod: -o is missing: --sequence with --arm needs a folder for its results\n"
    )  # fmt: skip
    assert piezod("run", bench, "-o", tmp_path / "x").returncode == 2
