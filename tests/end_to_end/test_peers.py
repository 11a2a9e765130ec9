"""Other methods on concealed cases: what they are given, and how they are judged; a stub stands for each of them."""

import dataclasses
import json
import shutil
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from firmware_sim.concealed.study.make import make
from piezod.errors import ConfigurationError, UsageError
from piezod.recording import Recording, read_csv, write_csv
from tests.benches.emulator import ROOT
from tests.studies.peers import study as studies
from tests.studies.peers.given import given
from tests.studies.peers.run import PEERS, Peer, ask, read_answer, read_prediction
from tests.studies.peers.study import Wanted, compare

CASE, EFFECT, SEED = "case_0001", "output_nonlinearity", 13  # its cases are short
GIVEN_FILES = {"exchange.py", "given.json", "held_out.npz", "identification.npz", "peer.py"}
LOOKS_AROUND = """
    import json, os, sys
    import exchange

    given = exchange.read()
    seen = {
        "files": sorted(os.listdir()),
        "environment": dict(os.environ),
        "arguments": sys.argv,
        "input": sys.stdin.read(),
        "held_out": sorted(given.held_out.columns),
        "recordings": [sorted(record.columns) for record in given.recordings],
        "identification": sorted(given.identification.columns),
    }
    exchange.answer(given, given.held_out["base_N"] + given.recordings[0].missing_N[0], [json.dumps(seen)], "", 1)
"""
SAYS_NOTHING = """
    import exchange

    given = exchange.read()
    exchange.answer(given, given.held_out["base_N"], [], "none", 1)
"""
RUNS_AWAY = """
    import exchange, numpy

    given = exchange.read()
    exchange.answer(given, numpy.where(given.held_out["time_s"] > 1.0, numpy.nan, 0.0), ["temperature_C u"], "all", 1)
"""
DIES = "raise SystemExit('no solution')"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of one null and one of one single, and verdicts as a diagnosis that is right would write them."""
    folder = tmp_path_factory.mktemp("peers")
    for kind, verdict, names in (("null", "matches", []), ("single", "explained", [EFFECT])):
        make(folder / kind, 1, seed=SEED, kind=kind, effect=EFFECT, strength=20.0)
        case, told = folder / kind / CASE, folder / f"{kind}_verdicts" / CASE
        told.mkdir(parents=True)
        base = Recording(read_csv(case / "held_out.csv").time_s, {"force_N": given(case, told).held_out["base_N"]})
        write_csv(base, told / "simulated_held_out_base.csv")
        write_csv(read_csv(case / "held_out.csv") if names else base, told / "simulated_held_out.csv")
        effects = [{"name": name, "confidence": 0.99} for name in names]
        findings = {"schema": "piezod.findings/1", "verdict": verdict, "effects": effects}
        (told / "findings.json").write_text(json.dumps(findings), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def cases(study):
    """What is given of the two cases."""
    return {kind: given(study / kind / CASE, study / f"{kind}_verdicts" / CASE) for kind in ("null", "single")}


@pytest.fixture
def peer(tmp_path):
    """Makes a peer of a program."""

    def make(program):
        path = tmp_path / "peer.py"
        path.write_text(textwrap.dedent(program), encoding="utf-8")
        return Peer("stub", path, ())

    return make


@pytest.fixture
def compared(monkeypatch, study, cases, tmp_path):
    """Compares a stub with `piezod` on one of the studies: what came of it, and the two rows."""

    def run(stub, kind, folder="out"):
        monkeypatch.setitem(PEERS, "stub", stub)
        monkeypatch.setattr(studies, "interpreter", lambda *_: sys.executable)
        monkeypatch.setattr(studies, "given", lambda *_: cases[kind])
        (tmp_path / folder).mkdir(exist_ok=True)
        wanted = Wanted(study / kind, study / f"{kind}_verdicts", (), None, ("stub",))
        found = compare(wanted, tmp_path / folder, tmp_path)
        return found, *found.rows

    return run


def test_a_peer_sees_neither_the_truth_nor_the_held_out_force(study, cases, peer, tmp_path):
    answer = ask(peer(LOOKS_AROUND), sys.executable, cases["null"], tmp_path / "answer")
    assert answer.failed == ""
    (told,) = answer.terms
    seen = json.loads(told)
    assert "force_N" not in seen["held_out"]
    assert all("force_N" in columns and "base_N" in columns for columns in seen["recordings"])
    assert "force_N" in seen["identification"]
    names = {f"recording_{number}.npz" for number in range(1, len(seen["recordings"]) + 1)}
    assert set(seen["files"]) - {"__pycache__"} == GIVEN_FILES | names
    assert seen["input"] == ""
    for place in (str(study), str(ROOT), "sealed"):
        assert place not in told


def test_what_peers_are_given_is_the_same_without_the_truth_and_without_the_held_out_force(study, cases, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(study / "null", bare, ignore=shutil.ignore_patterns("*sealed"))
    path = bare / CASE / "held_out.csv"
    record = read_csv(path)
    force_N = np.random.default_rng(SEED).normal(size=record.time_s.size)
    write_csv(Recording(record.time_s, {**record.channels, "force_N": force_N}), path)
    with_it, without = cases["null"], given(bare / CASE, study / "null_verdicts" / CASE)
    for one, other in zip(
        (with_it.held_out, with_it.identification, *with_it.recordings),
        (without.held_out, without.identification, *without.recordings),
        strict=True,
    ):
        assert one.keys() == other.keys()
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_a_verdict_on_another_model_is_refused(study, tmp_path):
    verdict = tmp_path / CASE
    shutil.copytree(study / "null_verdicts" / CASE, verdict)
    path = verdict / "simulated_held_out_base.csv"
    record = read_csv(path)
    write_csv(Recording(record.time_s, {"force_N": 1.001 * record.channel("force_N")}), path)
    with pytest.raises(ConfigurationError, match=r"differs by .* from the model identified now"):
        given(study / "null" / CASE, verdict)


def test_a_peer_that_adds_nothing_closes_nothing_and_makes_nothing_worse(compared, peer, capsys):
    found, ours, theirs = compared(peer(SAYS_NOTHING), "single")
    assert found.whole
    assert theirs.gaps == [pytest.approx(0.0, abs=1e-12)]
    assert theirs.worse == (0, 1)
    assert ours.gaps[0] > 0.9
    assert ours.names == "exact set 1 of 1"
    told = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in told] == [CASE, "method", "piezod", "stub", "1"]


def test_on_a_null_it_counts_who_says_that_nothing_is_missing(compared, peer):
    _, ours, quiet = compared(peer(SAYS_NOTHING), "null", "quiet")
    _, _, loud = compared(peer(RUNS_AWAY), "null", "loud")
    assert ours.nothing == quiet.nothing == (1, 1)
    assert ours.nulls_worse == quiet.nulls_worse == (0, 1)
    assert loud.nothing == (0, 1)
    assert loud.nulls_worse == (1, 1)
    assert loud.names == "does not name, but for thermal drift: 0 of 0, wrongly 1"


def test_a_prediction_that_diverges_is_cut_at_the_measured_range_and_counted_as_worse(compared, cases, peer, tmp_path):
    _, _, theirs = compared(peer(RUNS_AWAY), "single")
    case = cases["single"]
    force_N = read_prediction(tmp_path / "out" / "stub" / CASE)
    assert np.isfinite(force_N).all()
    assert np.max(np.abs(force_N - case.held_out["base_N"])) == pytest.approx(case.span_N)
    assert theirs.cases[0].diverged
    assert theirs.gaps[0] < 0.0
    assert theirs.worse == (1, 1)


def test_a_peer_that_fails_is_told_counted_and_closes_nothing(compared, peer, capsys):
    found, _, theirs = compared(peer(DIES), "single")
    assert not found.whole
    assert theirs.cases[0].failed
    assert theirs.gaps == [0.0]
    assert f"{CASE} stub: failed: ended with 1: no solution" in capsys.readouterr().out


def test_an_answer_of_another_version_of_the_peer_does_not_count(cases, peer, tmp_path):
    before = peer(SAYS_NOTHING)
    said = ask(before, sys.executable, cases["null"], tmp_path / "answer")
    assert read_answer(before, tmp_path / "answer") == said
    assert read_answer(peer(DIES), tmp_path / "answer") is None


def test_answers_on_another_study_are_not_mixed(compared, study, peer, tmp_path):
    compared(peer(SAYS_NOTHING), "null")
    wanted = Wanted(study / "single", study / "single_verdicts", (), None, ("stub",))
    with pytest.raises(UsageError, match="holds answers on another study"):
        compare(wanted, tmp_path / "out", tmp_path)
    with pytest.raises(UsageError, match="--peers names oracle"):
        compare(dataclasses.replace(wanted, peers=("oracle",)), tmp_path / "out", tmp_path)


def test_a_case_without_a_verdict_is_one_line_and_its_exit_code(study, tmp_path):
    command = [sys.executable, "-m", "tests.studies", "peers", str(study / "null"), str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 78, done.stderr
    assert done.stderr.count("\n") == 1
    assert "has no verdict; run piezod blind run first" in done.stderr
