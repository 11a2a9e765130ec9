"""Effects laid over real recordings and diagnosed.

A model is identified on one recording of a real bench. A second recording of that bench is diagnosed unchanged, and
with each effect laid over it (`overlaid_effects.py`). An effect is found when the diagnosis names it in addition, with
its parameter inside the interval or within `CLOSE_ENOUGH`. Where the bench has the effect itself, the parameter must
have grown by that much. The recordings are read from `../shared/recordings`.
"""

import json
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from piezod.recording import Recording, read_csv, write_csv
from tests.studies.overlaid_effects import OVERLAYS, BaseRecording, scaled_overlay, with_room_temperature
from tests.studies.scenarios import ROOT, StepError, run

REAL = ROOT.parent / "shared" / "recordings"
STRENGTH = 3.0  # of an effect, relative to the residual of the unchanged recording
CLOSE_ENOUGH = 0.1  # relative error of a parameter
PLACES = ("frequency_Hz", "from_s")  # do not add up with what the bench has itself
PAUSE = 5.0  # sample periods; the longest part without such a pause is used
SHORT_s, SHORT_ORDERS = 25.0, (14, 6)


@dataclass(frozen=True)
class Real:
    """Two recordings of a real bench.

    Parameters
    ----------
    identification, work
        File for the model, and file for the diagnosis.
    command, output
        Columns.
    effects
        Effects that are laid over it.
    """

    identification: str
    work: str
    command: str
    output: str
    effects: tuple[str, ...]


BENCHES = {
    "piezo-flexure": Real("identification.csv", "tracking.csv", "voltage_V", "displacement_um", tuple(OVERLAYS)),
    "pneumatic-friction": Real(
        "kidney_3bar.csv",
        "circle_3bar.csv",
        "displacement_mm",
        "force_N",
        ("load_step", "vibration", "sensor_filter", "sensor_dropout", "quantisation", "transport_delay"),
    ),
    "friction-damper": Real(
        "1Hz30lbtension1amplitude.csv",
        "2Hz30lbtension0p5amplitude.csv",
        "displacement_in",
        "force_kip",
        ("load_step", "vibration", "mains_hum", "sensor_dropout", "quantisation", "transport_delay"),
    ),
}


@dataclass(frozen=True)
class Verdict:
    """The compared results of a diagnosis."""

    word: str
    named: dict[str, dict[str, dict[str, float]]]
    rivals: tuple[str, ...]
    before: float
    after: float
    floor: float
    seconds: float


@dataclass(frozen=True)
class OverlayRow:
    """Result of one overlaid effect.

    Parameters
    ----------
    bench, effect
        Names of bench and effect.
    size
        Root mean square of the change over the residual of the unchanged recording.
    found
        Whether it is named in addition, with its parameter.
    named, rival
        Whether it is named; whether it is a rival of a named effect.
    parameter, true, value, low, high
        Parameter, its true and found value, and its interval; None without a comparison.
    alike
        Whether the emulated law uses the parameter as the catalogue defines it.
    verdict
        Verdict of the diagnosis.
    before, after, floor
        Error on held-out blocks with the given and the extended model, and the noise [output unit].
    extra, lost
        Additional names, and missing names, relative to the unchanged recording.
    seconds
        Duration of the diagnosis [s].
    why
        Error message; empty without an error.
    """

    bench: str
    effect: str
    size: float | None = None
    found: bool = False
    named: bool = False
    rival: bool = False
    parameter: str = ""
    true: float | None = None
    value: float | None = None
    low: float | None = None
    high: float | None = None
    alike: bool = True
    verdict: str = "failed"
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    extra: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    seconds: float | None = None
    why: str = ""

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self)

    def text(self) -> str:
        """One line, and a second one for an error."""
        interval = "-" if self.low is None else f"{_number(self.low)} to {_number(self.high)}"
        line = _COLUMNS.format(
            bench=self.bench,
            effect=self.effect,
            size=_number(self.size, 2),
            found="yes" if self.found else "NO",
            named="yes" if self.named else "rival" if self.rival else "no",
            parameter=self.parameter,
            true=_number(self.true),
            value=_number(self.value) + ("" if self.alike or self.value is None else "~"),
            interval=interval,
            verdict=self.verdict,
            before=_number(self.before, 3),
            after=_number(self.after, 3),
            floor=_number(self.floor, 3),
            extra=", ".join(self.extra) or "-",
            lost=", ".join(self.lost) or "-",
            seconds=_number(self.seconds, 3),
        ).rstrip()
        return f"{line}\n{'':<19}{self.why}" if self.why else line


_COLUMNS = (
    "{bench:<18} {effect:<20} {size:>5} {found:<5} {named:<5} {parameter:<22} {true:>8} {value:>9} {interval:<20} "
    "{verdict:<16} {before:>7} {after:>7} {floor:>7} {seconds:>5}  {extra:<30} {lost}"
)


def header() -> str:
    """The header line."""
    names = ("bench", "effect", "size", "found", "named", "parameter", "true", "value", "interval", "verdict")
    more = {name: name for name in ("before", "after", "floor", "extra", "lost")}
    return _COLUMNS.format(**{name: name for name in names}, **more, seconds="s").rstrip()


def summary(rows: Sequence[OverlayRow]) -> str:
    """The summary line."""
    laid = [row for row in rows if row.effect != "none"]
    missed = [f"{row.bench}/{row.effect}" for row in laid if not row.found]
    extra = sum(len(row.extra) for row in laid)
    not_found = f"; not: {', '.join(missed)}" if missed else ""
    return (
        f"{len(laid) - len(missed)} of {len(laid)} found, {sum(row.named for row in laid)} named, {extra} extra names"
        f"{not_found}. size: change over the residual of the unchanged recording; found: named in addition, with its "
        "parameter; a bench that has the effect itself shows a larger value; ~: another law, not compared"
    )


def overlay_study(
    benches: Sequence[str], only: Sequence[str], folder: Path, *, short: bool, strength: float, jobs: int
) -> Iterator[OverlayRow]:
    """Rows for every bench: first the unchanged recording, then each effect.

    Parameters
    ----------
    benches
        Names in `BENCHES`.
    only
        Effects; those that do not suit a bench are skipped.
    folder
        Folder for models, recordings and findings.
    short
        Use the first `SHORT_s` of each recording and a model of given orders.
    strength
        Strength of each effect.
    jobs
        Number of parallel diagnoses.
    """
    for name in benches:
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        try:
            bare, first = _unchanged(name, place, short=short)
        except StepError as error:
            yield OverlayRow(name, "none", why=str(error))
            continue
        yield _bare_row(name, first)
        effects = [effect for effect in BENCHES[name].effects if effect in only]
        threads = {"OMP_NUM_THREADS": "1"} if jobs > 1 else {}

        def row_of(effect: str, bare: BaseRecording = bare, first: Verdict = first, place: Path = place) -> OverlayRow:
            return _overlaid_row(place.name, effect, bare, first, place, strength, threads)  # noqa: B023  # same for all

        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(row_of, effects)


def _unchanged(name: str, folder: Path, *, short: bool) -> tuple[BaseRecording, Verdict]:
    """Identify the model of a bench; returns its unchanged second recording and the verdict on that."""
    real = BENCHES[name]
    columns = ("--input", real.command, "--output", real.output)
    orders = ("--plays", SHORT_ORDERS[0], "--dead-zones", SHORT_ORDERS[1]) if short else ()
    run("identify", REAL / name / real.identification, "-o", folder / "model.yaml", *columns, *orders)
    recording = with_room_temperature(evenly(read_csv(REAL / name / real.work), SHORT_s if short else None))
    write_csv(recording, folder / "none.csv")
    verdict = _diagnosed(folder, "none", real, {})
    return BaseRecording(recording, real.command, real.output, verdict.after), verdict


def evenly(recording: Recording, longest_s: float | None) -> Recording:
    """The longest part without a pause, resampled evenly from time 0; at most `longest_s` [s]."""
    time_s = recording.time_s
    dt_s = float(np.median(np.diff(time_s)))
    edges = np.concatenate(([0], np.flatnonzero(np.diff(time_s) > PAUSE * dt_s) + 1, [time_s.size]))
    widest = int(np.argmax(np.diff(edges)))
    part = slice(edges[widest], edges[widest + 1])
    length_s = time_s[part][-1] - time_s[part][0]
    grid_s = np.arange(round(min(length_s, longest_s or length_s) / dt_s) + 1) * dt_s
    channels = {
        name: np.interp(grid_s, time_s[part] - time_s[part][0], one[part]) for name, one in recording.channels.items()
    }
    return Recording(grid_s, channels, recording.metadata, recording.source)


def _overlaid_row(
    name: str, effect: str, bare: BaseRecording, first: Verdict, folder: Path, strength: float, threads: dict[str, str]
) -> OverlayRow:
    """Lay an effect over the recording, diagnose it, compare."""
    made, values, size = scaled_overlay(effect, bare, strength)
    if effect == "mains_hum":  # at 200 Hz its third harmonic folds onto the first
        values |= {"amplitude_N": _amplitude(bare, made, float(values["frequency_Hz"]))}
    write_csv(made, folder / f"{effect}.csv")
    try:
        verdict = _diagnosed(folder, effect, BENCHES[name], threads)
    except StepError as error:
        return OverlayRow(name, effect, size, why=str(error))
    return compared(name, effect, values, size, verdict, first)


def _amplitude(bare: BaseRecording, made: Recording, frequency_Hz: float) -> float:
    """Of a tone in what was laid over [output unit]."""
    change = made.channel(bare.output) - bare.recording.channel(bare.output)
    return 2.0 * abs(np.mean(change * np.exp(-2j * np.pi * frequency_Hz * made.time_s)))


def compared(
    name: str, effect: str, values: dict[str, object], size: float, verdict: Verdict, first: Verdict
) -> OverlayRow:
    """Compare a verdict with the overlaid effect and with the verdict on the unchanged recording."""
    how = OVERLAYS[effect]
    true = values["places_s"][0][0] if effect == "sensor_dropout" else float(values[how.parameter])
    row = OverlayRow(name, effect, size, parameter=how.parameter, true=true, alike=how.alike, verdict=verdict.word)
    row = replace(
        row,
        named=effect in verdict.named,
        rival=effect in verdict.rivals,
        before=verdict.before,
        after=verdict.after,
        floor=verdict.floor,
        extra=tuple(one for one in verdict.named if one != effect and one not in first.named),
        lost=tuple(one for one in first.named if one not in verdict.named),
        seconds=verdict.seconds,
    )
    if not row.named:
        return row
    found = verdict.named[effect][how.parameter]
    own = None if how.parameter in PLACES else first.named.get(effect, {}).get(how.parameter, {}).get("value")
    low, value, high = (_added(found[key], own, inverse=how.inverse) for key in ("low", "value", "high"))
    right = min(low, high) <= true <= max(low, high) or abs(value / true - 1.0) <= CLOSE_ENOUGH
    return replace(
        row,
        value=found["value"],
        low=found["low"],
        high=found["high"],
        found=right or not how.alike,
    )


def _added(found: float, own: float | None, *, inverse: bool) -> float:
    """What was laid over a bench with an effect of its own; one that grows as its parameter falls adds inverses."""
    if own is None:
        return found
    if not inverse:
        return found - own
    return np.inf if found == own else 1.0 / (1.0 / found - 1.0 / own)


def _bare_row(name: str, first: Verdict) -> OverlayRow:
    return OverlayRow(
        name,
        "none",
        found=True,
        verdict=first.word,
        before=first.before,
        after=first.after,
        floor=first.floor,
        extra=tuple(first.named),
        seconds=first.seconds,
    )


def _diagnosed(folder: Path, name: str, real: Real, threads: dict[str, str]) -> Verdict:
    begun_s = time.monotonic()
    out = folder / f"{name}.out"
    run(
        "diagnose", folder / f"{name}.csv", "--model", folder / "model.yaml", "-o", out, "--input", real.command,
        "--output", real.output, threads=threads,
    )  # fmt: skip
    findings = json.loads((out / "findings.json").read_text(encoding="utf-8"))
    fit = findings["fit"]["held_out"]
    return Verdict(
        findings["verdict"],
        {one["name"]: one["parameters"] for one in findings["effects"]},
        tuple(rival["name"] for one in findings["effects"] for rival in one["rivals"]),
        fit["before"],
        fit["after"],
        findings["noise_floor"]["value"],
        time.monotonic() - begun_s,
    )


def _number(value: float | None, digits: int = 4) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
