"""The contract of `import piezod`: documented, with examples that run, typed, and one sentence for a wrong call."""

import ast
import contextlib
import doctest
import importlib.util
import inspect
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import UnionType
from typing import Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np
import pytest

import piezod
from piezod.api.findings_document import FindingsDocument, ParameterEntry
from piezod.diagnose.findings import Base, HeldOut, Place, UnchangedEffect, Unnamed, Unrecorded, Value
from piezod.errors import ConfigurationError, PiezodError, RecordingError, UsageError
from piezod.model import load_model
from piezod.recording import write_recording

ROOT = Path(__file__).parents[2]
NAN, INF = float("nan"), float("inf")
TIME_S = np.arange(0.0, 12.0, 0.005)
VOLTAGE_V = 11.0 * TIME_S * (1.0 - abs(1.0 - TIME_S % 2.0))
NEVER_FAIL = {"Inverse.reset", "Identified.as_dict", "History.as_dict", "Recording.part"}


def public_callables():
    """(name, object) of the functions of the interface and of the methods of its classes in `piezod.api`."""
    for name in piezod.__all__:
        thing = getattr(piezod, name)
        if inspect.isfunction(thing):
            yield name, thing
        elif inspect.isclass(thing) and thing.__module__.startswith(("piezod.api", "piezod.recording")):
            for method in vars(thing):
                found = getattr(getattr(thing, method), "__func__", getattr(thing, method))  # of a class method
                if inspect.isfunction(found) and not method.startswith("_"):
                    yield f"{name}.{method}", found


CALLABLES = dict(public_callables())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files of the examples: a bench before and after it began to answer 30 ms late, and its model."""
    path = tmp_path_factory.mktemp("examples")
    shutil.copy(ROOT / "config" / "model.yaml", path / "model.yaml")
    force_N = load_model(path / "model.yaml").operator().run(VOLTAGE_V)
    late_N = np.concatenate((np.full(6, force_N[0]), force_N[:-6]))
    for name, true_N in (("before", force_N), ("later", late_N)):
        readings = true_N + np.random.default_rng(len(name)).normal(0.0, 0.1, TIME_S.size)
        write_recording(piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V, "force_N": readings}), path / f"{name}.csv")
    return path


@pytest.fixture(scope="module")
def names(folder):
    """What the examples and the calls refer to."""
    recording = piezod.read_recording(folder / "before.csv")
    found = piezod.identify(recording)
    given = {
        "recording": recording,
        "model": piezod.Model.load(folder / "model.yaml"),
        "found": found,
        "diagnosis": piezod.diagnose(folder / "later.csv", found),
        "time_s": TIME_S,
        "voltage_V": VOLTAGE_V,
        "force_N": recording.channel("force_N"),
        "nothing": piezod.Recording([], {"voltage_V": [], "force_N": []}),
        "a_sample": piezod.Recording([0.0], {"voltage_V": [0.0], "force_N": [0.0]}),
        "no_voltage": piezod.Recording(TIME_S, {"force_N": VOLTAGE_V}),
        "unknown_force": piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V, "force_N": VOLTAGE_V * NAN}),
        "unknown_voltage": piezod.Recording(TIME_S, {"voltage_V": VOLTAGE_V * NAN, "force_N": VOLTAGE_V}),
    }
    return given | {"piezod": piezod, "np": np, "NAN": NAN, "INF": INF}


def test_the_interface_offers_functions_and_methods():
    assert {"identify", "diagnose", "simulate", "read_recording", "Model.load", "Inverse.voltages"} <= set(CALLABLES)


@pytest.mark.parametrize("name", sorted(CALLABLES))
def test_a_docstring_states_result_errors_and_an_example(name):
    text, returned = inspect.getdoc(CALLABLES[name]), inspect.signature(CALLABLES[name]).return_annotation
    sections = {
        title for title in ("Returns", "Raises", "Examples") if re.search(rf"^{title}\n-+$", text, re.MULTILINE)
    }
    without = ({"Returns"} if returned in (None, "None") else set()) | ({"Raises"} if name in NEVER_FAIL else set())
    if name.startswith("Recording."):
        without |= {"Returns"}  # their first line and their type say it
    assert sections == {"Returns", "Raises", "Examples"} - without


def test_every_example_gives_what_it_shows(names, folder):
    classes = {name: getattr(piezod, name) for name in piezod.__all__ if inspect.isclass(getattr(piezod, name))}
    texts = {name: inspect.getdoc(thing) or "" for name, thing in (CALLABLES | classes).items()}
    if importlib.util.find_spec("pandas") is None:
        texts = {name: text for name, text in texts.items() if ".frame()" not in text}
    run = 0
    with contextlib.chdir(folder):
        for name, text in texts.items():
            example = doctest.DocTestParser().get_doctest(text, dict(names), name, None, 0)
            result = doctest.DocTestRunner(verbose=False).run(example)
            assert result.failed == 0, name
            run += result.attempted
    assert run > 20


@pytest.mark.parametrize(
    "path", [*sorted((ROOT / "piezod" / "api").glob("*.py")), ROOT / "piezod/recording/recording.py"]
)
def test_no_signature_leaves_a_type_open(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id == "Any"] == []


def departures(kind, value, place="findings"):
    """Places of a document where it departs from its type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if is_typeddict(kind):
        return entry_departures(kind, value, place) if isinstance(value, dict) else [f"{place}: {value!r}"]
    if origin in (Union, UnionType):
        return min((departures(option, value, place) for option in arguments), key=len)
    if origin in (list, dict):
        if not isinstance(value, origin):
            return [f"{place}: {value!r}"]
        entries = enumerate(value) if origin is list else value.items()
        return [one for key, entry in entries for one in departures(arguments[-1], entry, f"{place}.{key}")]
    fits = value in arguments if origin is Literal else isinstance(value, (int, float) if kind is float else kind)
    return [] if fits else [f"{place}: {value!r}"]


def entry_departures(kind, value, place):
    """The same for an object with named keys."""
    keys, hints = set(value), get_type_hints(kind)
    wrong = [f"{place}: {keys ^ set(hints)}"] if keys - set(hints) or kind.__required_keys__ - keys else []
    return wrong + [one for key in keys & set(hints) for one in departures(hints[key], value[key], f"{place}.{key}")]


@pytest.mark.parametrize("example", ["found", "seen", "law"])
def test_findings_have_the_types_that_a_checker_is_given(example, names):
    findings = names["diagnosis"].diagnosis.findings
    place = Place("voltage_V", 0.0, 1.0)
    value = Value(1.0, "s", 0.9, 1.1)
    changed = {
        "found": {},
        "seen": {
            "kept": (UnchangedEffect("creep", {"from_s": value}, seen=True),),
            "base": Base(changed=True, gain=value, loops=value, where=(place,)),
            "held_out": (HeldOut("a.csv", "0", 1.0, 0.5),),
            "effects": tuple(replace(effect, was=effect.parameters) for effect in findings.effects),
            "floor_from": "repeats",
        },
        "law": {
            "law": Unnamed(("voltage_V",), (0.1, 1.0), already=True, before=1.0, after=0.5, p=0.01),
            "unrecorded": Unrecorded(1.0, gain=True, keeps_s=2.0),
            "where": (place,),
        },
    }
    document = json.loads(json.dumps(replace(findings, **changed[example]).as_dict()))
    assert departures(FindingsDocument, document) == []


def test_a_departure_from_the_types_is_seen():
    right = {"value": 1.0, "unit": "s", "low": 0.0, "high": 2.0}
    assert departures(ParameterEntry, right | {"was": right}) == []
    assert departures(ParameterEntry, right | {"more": 1}) != []
    assert departures(ParameterEntry, right | {"value": "1"}) == ["findings.value: '1'"]
    assert departures(ParameterEntry, {"value": 1.0}) != []


# Expression, and what its answer begins with.
RIGHT = [
    ("piezod.Recording([0, 1, 2], {'force_N': [1, 2, 3]})", "Recording"),
    ("piezod.Recording(time_s, {})", "Recording"),
    ("piezod.Recording.from_frame(recording.frame())", "Recording"),
    ("recording.channel('-force_N')", "ndarray"),
    ("recording.resampled(np.float32(0.01))", "Recording"),
    ("piezod.read_recording('before.csv')", "Recording"),
    ("piezod.read_recording('before.csv', scale='force_N=2 N/N')", "Recording"),
    ("piezod.identify([recording], plays=np.int64(4), dead_zones=2)", "Identified"),
    ("piezod.identify(recording.frame(), plays=4)", "Identified"),
    ("piezod.simulate(recording, model)", "Recording"),
    ("piezod.simulate(recording, found)", "Recording"),
    ("piezod.simulate(recording, diagnosis)", "Recording"),
    ("piezod.simulate(recording, 'model.yaml', start_window_s=0)", "Recording"),
    ("piezod.simulate(recording, load_model('model.yaml'))", "Recording"),
    ("piezod.diagnose('later.csv', diagnosis, within_s=1)", "Diagnosed"),
    ("piezod.Inverse(found, 1000).voltages([1, 2])", "ndarray"),
    ("piezod.Inverse(diagnosis, 1000).plan(1)", "float"),
    ("model.inverse().voltages([])", "ndarray"),
    ("piezod.Model.of(diagnosis)", "Model"),
    ("piezod.history(['model.yaml'])", "History"),
    ("piezod.history(Path('.'))", "History"),
]
NO_RECORDING = "must be a path, a Recording or a pandas frame"
NO_MODEL = "must be a Model, a result of identify or diagnose, or the path of a model file"
ONE_ROW = "must be one row of samples"
ORDER = "must be a whole number from 1 to 100"
# Expression, kind of its error, and part of its sentence.
WRONG = [
    ("piezod.Recording(None, {})", RecordingError, ONE_ROW),
    ("piezod.Recording(1.0, {'force_N': 1.0})", RecordingError, ONE_ROW),
    ("piezod.Recording(time_s, None)", RecordingError, "channels must be names with values"),
    ("piezod.Recording(time_s, [force_N])", RecordingError, "channels must be names with values"),
    ("piezod.Recording(time_s, {1: force_N})", RecordingError, "channels must be names with values"),
    ("piezod.Recording(time_s, {'force_N': None})", RecordingError, ONE_ROW),
    ("piezod.Recording(time_s, {'force_N': 'abc'})", RecordingError, "force_N must hold numbers"),
    ("piezod.Recording(time_s, {'force_N': force_N[:5]})", RecordingError, "force_N has 5 samples, time_s has 2400"),
    ("piezod.Recording(time_s, {'force_N': force_N[:, None]})", RecordingError, "force_N has the shape (2400, 1)"),
    ("piezod.Recording(time_s, {'force_N': force_N + 1j})", RecordingError, "force_N holds complex numbers"),
    ("piezod.Recording(time_s * NAN, {})", RecordingError, "time_s of sample 0 is not finite"),
    ("piezod.Recording(time_s[::-1], {})", RecordingError, "time_s must strictly increase"),
    ("piezod.Recording.from_frame(None)", RecordingError, "is a NoneType, must be a pandas frame"),
    ("piezod.Recording.from_frame(recording.frame().astype(str).add('x'))", RecordingError, "must hold numbers"),
    ("recording.channel(None)", RecordingError, "has no column None, has voltage_V, force_N"),
    ("recording.resampled(None)", RecordingError, "must be above 0"),
    ("recording.resampled(NAN)", RecordingError, "must be above 0"),
    ("piezod.read_recording(None)", UsageError, "path is None, must be the path of a file"),
    ("piezod.read_recording(3)", UsageError, "path is 3, must be the path of a file"),
    ("piezod.read_recording(b'before.csv')", UsageError, "path is b'before.csv', must be"),
    ("piezod.read_recording('')", UsageError, "path is '', must be"),
    ("piezod.read_recording(recording)", UsageError, "path is of the kind Recording, must be"),
    ("piezod.read_recording('nothing.csv')", RecordingError, "nothing.csv: cannot be read"),
    ("piezod.read_recording('before.csv', rate_Hz=NAN)", UsageError, "rate_Hz is nan, must be a finite number above 0"),
    ("piezod.read_recording('before.csv', rate_Hz='1')", UsageError, "rate_Hz is '1', must be a finite number"),
    ("piezod.read_recording('before.csv', columns=['time_s'])", UsageError, "columns is ['time_s'], must be text"),
    ("piezod.read_recording('before.csv', decimal=';')", UsageError, "must be . or ,"),
    ("piezod.read_recording('before.csv', scale=[3])", UsageError, "scale is [3], must be a text or a list of texts"),
    ("piezod.read_recording('before.csv', scale='3')", UsageError, "must be COLUMN=FACTOR UNIT"),
    ("piezod.identify(None)", UsageError, NO_RECORDING),
    ("piezod.identify(3.0)", UsageError, NO_RECORDING),
    ("piezod.identify(force_N)", UsageError, NO_RECORDING),
    ("piezod.identify((time_s, voltage_V, force_N))", UsageError, NO_RECORDING),
    ("piezod.identify({'force_N': force_N})", UsageError, NO_RECORDING),
    ("piezod.identify([recording, None])", UsageError, NO_RECORDING),
    ("piezod.identify(model)", UsageError, NO_RECORDING),
    ("piezod.identify([])", UsageError, "no recording is given, must be at least one"),
    ("piezod.identify(nothing)", RecordingError, "voltage_V holds no number at all"),
    ("piezod.identify(a_sample)", RecordingError, "has 1 samples, needs at least 100"),
    ("piezod.identify(unknown_force)", RecordingError, "force_N holds no number at all"),
    ("piezod.identify(unknown_voltage)", RecordingError, "voltage_V holds no number at all"),
    ("piezod.identify(recording, plays=0)", UsageError, ORDER),
    ("piezod.identify(recording, plays=2.5)", UsageError, ORDER),
    ("piezod.identify(recording, plays='3')", UsageError, ORDER),
    ("piezod.identify(recording, plays=True)", UsageError, ORDER),
    ("piezod.identify(recording, plays=NAN)", UsageError, ORDER),
    ("piezod.identify(recording, dead_zones=-1)", UsageError, "dead_zones is -1, must be a whole number from 0 to 30"),
    ("piezod.identify(recording, input='x_V')", RecordingError, "has no column x_V"),
    ("piezod.identify(recording, input=3)", UsageError, "input is 3, must be text"),
    ("piezod.identify(recording, name=None)", UsageError, "name is None, must be text"),
    ("piezod.identify(recording, on_step=None)", UsageError, "on_step is None, must be a function"),
    ("piezod.simulate(None, model)", UsageError, NO_RECORDING),
    ("piezod.simulate([recording], model)", UsageError, NO_RECORDING),
    ("piezod.simulate(nothing, model)", RecordingError, "has no samples"),
    ("piezod.simulate(no_voltage, model)", RecordingError, "has no column voltage_V, has force_N"),
    ("piezod.simulate(unknown_voltage, model)", UsageError, "voltage_V has missing samples"),
    ("piezod.simulate(recording, None)", UsageError, NO_MODEL),
    ("piezod.simulate(recording, 3)", UsageError, NO_MODEL),
    ("piezod.simulate(recording, {})", UsageError, NO_MODEL),
    ("piezod.simulate(recording, recording)", UsageError, NO_MODEL),
    ("piezod.simulate(recording, 'nothing.yaml')", ConfigurationError, "nothing.yaml: cannot be read"),
    ("piezod.simulate(recording, 'before.csv')", ConfigurationError, "must be a mapping of keys to values"),
    ("piezod.simulate(recording, model, start_window_s=-1)", UsageError, "must be a finite number of at least 0"),
    ("piezod.simulate(recording, model, start_window_s=None)", UsageError, "start_window_s is None"),
    ("piezod.simulate(recording, model, start_window_s=INF)", UsageError, "start_window_s is inf"),
    ("piezod.diagnose(None, model)", UsageError, NO_RECORDING),
    ("piezod.diagnose([], model)", UsageError, "no recording is given, must be at least one"),
    ("piezod.diagnose(recording, None)", UsageError, NO_MODEL),
    ("piezod.diagnose([recording, recording], model)", UsageError, "a recording is given twice"),
    ("piezod.diagnose(a_sample, model)", RecordingError, "has 1 samples, needs at least 500"),
    ("piezod.diagnose(unknown_force, model)", RecordingError, "force_N has 0 readings, needs 500"),
    ("piezod.diagnose(recording, model, where=3)", UsageError, "where is 3, must be text"),
    ("piezod.diagnose(recording, model, where='x')", UsageError, "must be COLUMN=NUMBER"),
    ("piezod.diagnose(recording, model, within_s=0)", UsageError, "within_s is 0, must be a finite number above 0"),
    ("piezod.diagnose(recording, model, within_s=NAN)", UsageError, "within_s is nan"),
    ("piezod.diagnose(recording, model, on_step=3)", UsageError, "on_step is 3, must be a function"),
    ("piezod.Model.load(None)", UsageError, "path is None, must be the path of a file"),
    ("piezod.Model.load('.')", ConfigurationError, "cannot be read"),
    ("piezod.Model.of(None)", UsageError, NO_MODEL),
    ("piezod.Model.of(recording)", UsageError, NO_MODEL),
    ("model.save(None)", UsageError, "path is None, must be the path of a file"),
    ("model.save('nothing/model.yaml')", ConfigurationError, "cannot be written"),
    ("model.inverse(0)", UsageError, "rate_Hz is 0, must be a finite number above 0"),
    ("model.inverse(None)", UsageError, "rate_Hz is None"),
    ("model.inverse(NAN)", UsageError, "rate_Hz is nan"),
    ("piezod.Inverse(None, 1000.0)", UsageError, NO_MODEL),
    ("model.inverse().plan(NAN)", UsageError, "reference is nan, must be a finite number"),
    ("model.inverse().plan(None)", UsageError, "reference is None, must be a finite number"),
    ("model.inverse().commit([1.0, 2.0])", UsageError, "voltage_V is [1.0, 2.0], must be a finite number"),
    ("model.inverse().voltages(3.0)", UsageError, "reference has the shape (), must be one row of numbers"),
    ("model.inverse().voltages([[1.0]])", UsageError, "reference has the shape (1, 1)"),
    ("model.inverse().voltages([1.0, NAN])", UsageError, "reference is nan at sample 1, must be finite"),
    ("model.inverse().voltages('abc')", UsageError, "reference is 'abc', must be one row of numbers"),
    ("piezod.history(None)", UsageError, "paths is None, must be the path of a file"),
    ("piezod.history([])", UsageError, "no model is given, must be at least one"),
    ("piezod.history([model])", UsageError, "paths is of the kind Model, must be the path of a file"),
    ("piezod.history('nothing.yaml')", ConfigurationError, "nothing.yaml: cannot be read"),
    ("piezod.history('before.csv')", ConfigurationError, "must be a mapping of keys to values"),
    ("found.write_page(None)", UsageError, "path is None, must be the path of a file"),
    ("diagnosis.write_page(3)", UsageError, "path is 3, must be the path of a file"),
]


def answer(call, names, folder):
    with contextlib.chdir(folder):
        return eval(call, names | {"load_model": load_model, "Path": Path})


@pytest.mark.parametrize(("call", "kind"), RIGHT, ids=[call for call, _ in RIGHT])
def test_a_right_call_is_answered(call, kind, names, folder):
    if "frame" in call:
        pytest.importorskip("pandas")
    assert type(answer(call, names, folder)).__name__ == kind


@pytest.mark.parametrize(("call", "kind", "sentence"), WRONG, ids=[call for call, _, _ in WRONG])
def test_a_wrong_call_is_answered_by_a_sentence(call, kind, sentence, names, folder):
    if "recording.frame" in call:
        pytest.importorskip("pandas")
    with pytest.raises(PiezodError) as raised:
        answer(call, names, folder)
    assert isinstance(raised.value, kind)
    assert sentence in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1
