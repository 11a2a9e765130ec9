"""The order of an investigation: drives are asked about, planned ones are driven, and it ends when nothing is open."""

from types import SimpleNamespace

import numpy as np
import pytest

from piezod.commissioning import investigate as room
from piezod.diagnose.experiment.isolability import Isolability, Pair
from piezod.diagnose.experiment.planning import Experiment
from piezod.diagnose.findings import Finding, Rival
from piezod.recording import Recording, read_recording

PAIR = ("creep", "thermal_drift")
FITTED = {name: ({"size": 1.0}, ()) for name in PAIR}
RIVALS = (Rival(PAIR[1], 0.3, "a hold"),)


def found(size):
    """Creep of a size in noises of 0.1 N, with a rival."""
    effect = Finding(PAIR[0], "creep", 0.9, "since", (), {}, float(np.hypot(1.0, 0.1 * size)), 1.0, RIVALS)
    return SimpleNamespace(findings=SimpleNamespace(effects=(effect,)), fitted=lambda: FITTED)


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """A bench that answers with zeros; the third makes creep larger than what separates it from its rival."""
    driven, diagnosed = [], []

    def record(config, excitation, **_):
        driven.append(excitation)
        channels = {"voltage_V": np.arange(4.0), "force_N": np.zeros(4)}
        metadata = {"recorded": f"2026-11-26T12:00:{10 * len(driven):02d}+00:00"}
        return Recording(np.arange(4) * 0.1, channels, metadata, "x"), SimpleNamespace(fault="", stopped=False)

    def diagnose(recordings, *_):
        (path,) = recordings
        diagnosed.append(read_recording(path))
        return found((3.0, 4.9, 5.1)[len(diagnosed) - 1])

    def plan(model, asked, past, known, longest_s, wanted, fitted, slew):
        assert list(wanted) == [PAIR]
        assert fitted is FITTED
        assert slew == 300.0
        return Experiment(np.arange(3.0), 0.1, ("steps",), (Pair(*PAIR, 9.0, "a hold"),), (3.0,))

    known = Isolability(PAIR, np.ones(2), np.array([[0.0, 4.0], [5.0, 0.0]]), 0.1, ())
    channels = SimpleNamespace(channel="voltage_V"), SimpleNamespace(channel="force_N")
    limits = SimpleNamespace(limits=SimpleNamespace(voltage_safe_V=0.0, slew_V_per_s=400.0, fall_V_per_s=300.0))
    monkeypatch.setattr(room, "load_bench_without_model", lambda _: limits)
    monkeypatch.setattr(room, "load_model", lambda _: SimpleNamespace(input=channels[0], output=channels[1]))
    monkeypatch.setattr(room, "record_excitation", record)
    monkeypatch.setattr(room, "diagnose_files", diagnose)
    monkeypatch.setattr(room, "next_experiment", plan)
    monkeypatch.setattr(room, "isolability", lambda *_: known)
    monkeypatch.setattr(room, "past_sources", lambda *_: ([], []))
    return SimpleNamespace(folder=tmp_path, driven=driven, diagnosed=diagnosed)


def steps(bench, most_drives=5, agreed=lambda _: True):
    settings = {"excitation": "constant-triangles", "most_drives": most_drives, "longest_s": 60.0, "agreed": agreed}
    progress = {"on_rows": lambda _: None, "on_step": lambda *_: None}
    return list(
        room.investigate(bench.folder / "b.yaml", bench.folder / "m.yaml", bench.folder, **settings, **progress)
    )


def test_it_goes_on_with_planned_drives_until_no_rival_is_open(bench):
    done = steps(bench)
    drives = [str(bench.folder / f"drive_{k}.csv") for k in (2, 3)]
    assert bench.driven == ["constant-triangles", *drives]
    whole = bench.diagnosed[-1]
    np.testing.assert_allclose(np.diff(whole.time_s), 0.1, atol=1e-9)
    voltage_V, rest = whole.channel("voltage_V"), np.zeros(97)  # 10 s from end to end, less 0.3 s of the recording
    np.testing.assert_array_equal(
        voltage_V, np.concatenate([np.arange(4.0), rest, np.arange(4.0), rest, np.arange(4.0)])
    )
    assert np.count_nonzero(np.isnan(whole.channel("force_N"))) == 2 * 97
    assert [step.open_pairs for step in done] == [(PAIR,), (PAIR,), ()]
    assert [step.reached for step in done] == [(), (5.0,), (5.0,)]
    assert [step.promised is None for step in done] == [True, False, False]
    np.testing.assert_array_equal(read_recording(bench.folder / "drive_2.csv").channel("voltage_V"), np.arange(3.0))


def test_nothing_is_driven_without_agreement_and_no_more_than_allowed(bench):
    asked = []
    assert len(steps(bench, agreed=lambda drive: asked.append(drive) or drive.number < 2)) == 1
    assert [drive.number for drive in asked] == [1, 2]
    assert len(bench.driven) == 1
    assert asked[1].duration_s == pytest.approx(0.2)
    assert len(steps(bench, most_drives=2)) == 2
