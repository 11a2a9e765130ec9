"""Calls of the Python interface, right and wrong, with the answer of each: `python -m tests.studies api_calls`.

A wrong call must be answered by an error of piezod in one line. An answer of numpy, pandas or Python's own is counted.
"""

import argparse
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import piezod
from piezod.errors import PiezodError
from piezod.excitation import excitation
from tests.benches.world_files import COLUMNS

SHOWN = 150  # characters of an answer


def add_options(parser: argparse.ArgumentParser) -> None:
    """The study has no options."""
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Make every call, and print a line each."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        for words, call, is_right in calls(Path(folder)):
            kind, answer = answered(call, is_right=is_right)
            counts[kind] += 1
            print(f"{kind:10} {words:62} {answer.replace(folder, 'FOLDER')[:SHOWN]}", flush=True)
    print(f"{counts.total()} calls: " + ", ".join(f"{count} {kind}" for kind, count in counts.most_common()))


def answered(call: Callable[[], object], *, is_right: bool) -> tuple[str, str]:
    """Kind of an answer and its words: `done`, `told` (one line of piezod), `UNTOLD`, `TAKEN` or `REFUSED`."""
    try:
        result = call()
    except PiezodError as error:
        text = str(error)
        return ("REFUSED" if is_right else "told" if "\n" not in text else "UNTOLD"), text
    except Exception as error:  # noqa: BLE001  any other kind is what is looked for
        return "UNTOLD", f"{type(error).__name__}: {error}".replace("\n", " ")
    first = str(result).splitlines()[0] if str(result) else ""
    return ("done" if is_right else "TAKEN"), first


def calls(folder: Path) -> list[tuple[str, Callable[[], object], bool]]:
    """Text of each call, the call, and whether it is right."""
    recording = _recording()
    path = folder / "rec.csv"
    recording_path = str(path)
    _write(path, recording)
    identified = piezod.identify(recording)
    model = identified.model
    model.save(folder / "model.yaml")
    inverse = model.inverse(200.0)
    time_s, voltage_V, force_N = recording.time_s, recording.channels["voltage_V"], recording.channels["force_N"]
    holed = force_N.copy()
    holed[100:110] = np.nan

    def made(**channels: object) -> piezod.Recording:
        return piezod.Recording(time_s, channels)

    right = [
        ("read_recording(path)", lambda: piezod.read_recording(recording_path)),
        ("read_recording(Path)", lambda: piezod.read_recording(path)),
        ("Recording(time_s, channels)", lambda: made(voltage_V=voltage_V, force_N=force_N)),
        ("Recording of lists", lambda: piezod.Recording(list(time_s), {"voltage_V": list(voltage_V)})),
        ("recording.frame()", lambda: len(recording.frame())),
        ("Recording.from_frame(frame)", lambda: piezod.Recording.from_frame(recording.frame())),
        ("identify(recording)", lambda: identified),
        ("identify(path)", lambda: piezod.identify(path)),
        ("identify([recording, path])", lambda: piezod.identify([recording, path])),
        ("identify(frame)", lambda: piezod.identify(recording.frame())),
        ("identify with 10 missing samples", lambda: piezod.identify(made(voltage_V=voltage_V, force_N=holed))),
        ("simulate(recording, model)", lambda: piezod.simulate(recording, model)),
        ("simulate(recording, identified)", lambda: piezod.simulate(recording, identified)),
        ("simulate(path, path of model)", lambda: piezod.simulate(path, folder / "model.yaml")),
        ("Model.load(path)", lambda: piezod.Model.load(folder / "model.yaml")),
        (
            "model.inverse().voltages(reference)",
            lambda: model.inverse(200.0).voltages(np.linspace(20.0, 100.0, 50)).shape,
        ),
        ("inverse.plan, commit", lambda: inverse.commit(inverse.plan(50.0))),
        ("history([path of model])", lambda: piezod.history([folder / "model.yaml"])),
        ("identified.write_page(path)", lambda: identified.write_page(folder / "page.html")),
        ("EFFECTS['creep']", lambda: piezod.EFFECTS["creep"].title),
    ]
    wrong = [
        ("read_recording(None)", lambda: piezod.read_recording(None)),
        ("read_recording(5)", lambda: piezod.read_recording(5)),
        ("read_recording('none.csv')", lambda: piezod.read_recording("none.csv")),
        ("read_recording(folder)", lambda: piezod.read_recording(folder)),
        ("Recording(None, {})", lambda: piezod.Recording(None, {})),
        ("Recording(time_s, None)", lambda: piezod.Recording(time_s, None)),
        ("Recording, channel one sample short", lambda: made(voltage_V=voltage_V[:-1])),
        ("Recording, channel of words", lambda: made(voltage_V=["a"] * time_s.size)),
        ("Recording, channel a scalar", lambda: made(voltage_V=1.0)),
        ("Recording, channel of two dimensions", lambda: made(voltage_V=np.ones((time_s.size, 2)))),
        ("Recording, complex channel", lambda: made(voltage_V=voltage_V + 1j)),
        ("Recording, time backwards", lambda: piezod.Recording(time_s[::-1], {"voltage_V": voltage_V})),
        (
            "Recording, NaN in the time",
            lambda: piezod.Recording(np.where(time_s > 1, np.nan, time_s), {"voltage_V": voltage_V}),
        ),
        ("Recording.from_frame(dict)", lambda: piezod.Recording.from_frame({"time_s": time_s})),
        ("recording.channel('force')", lambda: recording.channel("force")),
        ("identify(None)", lambda: piezod.identify(None)),
        ("identify([])", lambda: piezod.identify([])),
        ("identify(3.0)", lambda: piezod.identify(3.0)),
        ("identify(array)", lambda: piezod.identify(force_N)),
        ("identify({})", lambda: piezod.identify({})),
        ("identify without a voltage", lambda: piezod.identify(made(force_N=force_N))),
        (
            "identify, force all NaN",
            lambda: piezod.identify(made(voltage_V=voltage_V, force_N=np.full_like(force_N, np.nan))),
        ),
        (
            "identify, voltage constant",
            lambda: piezod.identify(made(voltage_V=np.ones_like(voltage_V), force_N=force_N)),
        ),
        (
            "identify, 5 samples",
            lambda: piezod.identify(piezod.Recording(time_s[:5], {"voltage_V": voltage_V[:5], "force_N": force_N[:5]})),
        ),
        ("identify(recording, plays=-1)", lambda: piezod.identify(recording, plays=-1)),
        ("identify(recording, plays='many')", lambda: piezod.identify(recording, plays="many")),
        ("identify(recording, output='weight_N')", lambda: piezod.identify(recording, output="weight_N")),
        ("simulate(recording, None)", lambda: piezod.simulate(recording, None)),
        ("simulate(recording, 'none.yaml')", lambda: piezod.simulate(recording, "none.yaml")),
        ("simulate(recording, recording)", lambda: piezod.simulate(recording, recording)),
        ("simulate(None, model)", lambda: piezod.simulate(None, model)),
        ("simulate(..., start_window_s=nan)", lambda: piezod.simulate(recording, model, start_window_s=float("nan"))),
        ("simulate(..., start_window_s=None)", lambda: piezod.simulate(recording, model, start_window_s=None)),
        ("diagnose(recording, None)", lambda: piezod.diagnose(recording, None)),
        ("diagnose([], model)", lambda: piezod.diagnose([], model)),
        ("diagnose(recording, 7)", lambda: piezod.diagnose(recording, 7)),
        ("diagnose(..., within_s=-1)", lambda: piezod.diagnose(recording, model, within_s=-1)),
        ("diagnose(..., where='x')", lambda: piezod.diagnose(recording, model, where="x")),
        ("diagnose([recording, recording], model)", lambda: piezod.diagnose([recording, recording], model)),
        ("diagnose(..., on_step=5)", lambda: piezod.diagnose(recording, model, on_step=5)),
        ("Model.load('rec.csv')", lambda: piezod.Model.load(path)),
        ("Model.load(None)", lambda: piezod.Model.load(None)),
        ("model.save(None)", lambda: model.save(None)),
        ("model.save(folder that is missing)", lambda: model.save(folder / "none" / "model.yaml")),
        ("model.inverse(0)", lambda: model.inverse(0.0)),
        ("model.inverse(None)", lambda: model.inverse(None)),
        ("model.inverse(nan)", lambda: model.inverse(float("nan"))),
        ("inverse.plan(nan)", lambda: inverse.plan(float("nan"))),
        ("inverse.plan(None)", lambda: inverse.plan(None)),
        ("inverse.plan('50')", lambda: inverse.plan("50")),
        ("inverse.plan(array)", lambda: inverse.plan(np.ones(3))),
        ("inverse.commit(nan)", lambda: inverse.commit(float("nan"))),
        ("inverse.voltages(None)", lambda: inverse.voltages(None)),
        ("inverse.voltages of two dimensions", lambda: inverse.voltages(np.ones((3, 3)))),
        ("inverse.voltages with NaN", lambda: inverse.voltages([1.0, np.nan])),
        ("history([])", lambda: piezod.history([])),
        ("history(None)", lambda: piezod.history(None)),
        ("history('none')", lambda: piezod.history("none")),
        ("identified.write_page(folder)", lambda: identified.write_page(folder)),
        ("identified.write_page(None)", lambda: identified.write_page(None)),
    ]
    return [(f"piezod.{text}", call, True) for text, call in right] + [(text, call, False) for text, call in wrong]


def _recording() -> piezod.Recording:
    """Triangles of 50 s at 200 Hz, and a force with a loop and noise."""
    voltage_V = excitation("varying-triangles", 120.0, 0.1, 3, 200.0)
    time_s = np.arange(voltage_V.size) / 200.0
    play_V, state = np.empty_like(voltage_V), 0.0
    for k, value in enumerate(voltage_V):
        state = min(max(state, value - 8.0), value + 8.0)
        play_V[k] = state
    noise_N = 0.05 * np.random.default_rng(1).standard_normal(voltage_V.size)
    return piezod.Recording(time_s, {"voltage_V": voltage_V, "force_N": 1.5 * voltage_V + 0.6 * play_V + noise_N})


def _write(path: Path, recording: piezod.Recording) -> None:
    assert list(COLUMNS) == ["time_s", "voltage_V", "force_N"]
    table = np.column_stack([recording.time_s, *recording.channels.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(COLUMNS), comments="")
