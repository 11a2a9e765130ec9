"""Every parser is fuzzed for a few seconds; the fuzzer finds the defect of every broken parser."""

import signal
import subprocess
import sys
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezod.errors import PiezodError
from tests.fuzz import broken, files, frames, messages
from tests.fuzz.target import find_violation
from tests.fuzz.watch import ROOT, Watch
from tests.unit.recording.formats import suffixes

HANGS_AFTER_S = 60.0
ENDLESS_S = 900.0  # also on a busy machine
IN_PROCESS = [*frames.TARGETS, *files.TARGETS[:2], *messages.TARGETS]
EXAMPLES = {"frames": 600, "configurations": 60, "models": 80, "messages": 200}
RECORDINGS = 150


@pytest.fixture(autouse=True)
def watchdog():
    """Fail a test whose parser does not return within `ENDLESS_S`."""

    def fail(number, frame):
        raise TimeoutError(f"a fuzz test has run for {ENDLESS_S:.0f} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, ENDLESS_S)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("target", IN_PROCESS, ids=lambda target: target.name)
def test_parser_raises_refusals_only_and_accepts_what_the_standard_accepts(target):
    seeds, check = target.seeds(), target.check()
    for seed in seeds:
        assert not find_violation(check, seed)

    @settings(max_examples=EXAMPLES[target.group], suppress_health_check=[HealthCheck.too_slow])
    @given(
        number=st.integers(0, 2**32), seed=st.sampled_from(seeds), whole=st.binary(max_size=40), any_bytes=st.booleans()
    )
    def hold(number, seed, whole, any_bytes):
        data = whole if any_bytes and number % 4 == 0 else target.mutate(Random(number), seed, seeds)
        assert not find_violation(check, data)

    hold()


@pytest.mark.parametrize("suffix", suffixes(".csv", ".h5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite"))
def test_damaged_recording_causes_no_crash_no_hang_and_no_memory_growth(suffix, tmp_path):
    result = Watch("tests.fuzz.files", suffix[1:], "mutation", tmp_path).run(7, RECORDINGS)
    assert not result.findings, "\n".join(finding.text() for finding in result.findings)
    assert result.cases == RECORDINGS
    assert result.descriptors <= 0


@pytest.mark.parametrize(
    "target", [*frames.TARGETS, files.TARGETS[0], files.TARGETS[1]], ids=lambda target: target.name
)
def test_parser_accepts_at_least_four_valid_inputs(target):
    check = target.check()
    accepted = 0
    for seed in target.seeds():
        try:
            check(seed)
        except PiezodError as error:
            if "exception 4" not in str(error):  # the seeds of frames include an exception reply
                raise
        else:
            accepted += 1
    assert accepted >= 4


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("raises", "KeyError: 'three'"),
        ("crashes", "died of SIGSEGV"),
        ("hangs", "does not end"),
        ("sleeps", "does not end"),
        ("says_two_lines", "is not one printable line"),
        ("grows", "MiB"),
        ("asks_for_too_much", "memory ran out"),
        ("accepts_any_transaction", "the standard says"),
        ("ignores_the_checksum", "the standard says refuse"),
    ],
)
def test_fuzzer_finds_a_broken_parser_and_stores_the_input(name, says, tmp_path):
    hangs_after_s = {"hangs": 1.0, "sleeps": 0.2}.get(name, HANGS_AFTER_S)
    result = Watch("tests.fuzz.broken", name, "mutation", tmp_path, hangs_after_s=hangs_after_s, most_findings=1).run(
        1, 3000
    )
    assert result.findings
    finding = result.findings[0]
    assert says in finding.what
    assert finding.path.is_file()
    assert f"--reproduce {name} {finding.path}" in finding.text()
    if name not in ("crashes", "hangs", "sleeps", "grows"):  # in this process
        check = next(target for target in broken.TARGETS if target.name == name).check()
        assert says in find_violation(check, finding.path.read_bytes())


def test_fuzzer_counts_leaked_descriptors(tmp_path):
    assert Watch("tests.fuzz.broken", "leaks", "mutation", tmp_path).run(1, 300).descriptors > 10


def test_command_prints_a_table_and_repeats_a_stored_input(tmp_path):
    command = [sys.executable, "-m", "tests.fuzz"]
    done = subprocess.run(
        [*command, "--frames", "300", "--engine", "mutation", "--keep", tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "300 cases, 0 failed, 0 crashes, 0 hangs" in done.stdout
    stored = tmp_path / "stored"
    stored.write_bytes(frames.TARGETS[0].seeds()[0])
    again = subprocess.run(
        [*command, "--reproduce", "modbus_tcp", stored], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (again.returncode, again.stdout) == (0, "modbus_tcp: no violation\n")
