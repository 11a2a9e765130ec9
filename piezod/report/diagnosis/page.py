"""A diagnosis as one page: on its first screen what was wrong, where, and how sure; below it everything behind that."""

import csv
import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bokeh.model import Model
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod import __version__
from piezod.diagnose.diagnosis import Diagnosis
from piezod.diagnose.findings import Place
from piezod.diagnose.locate import locate
from piezod.diagnose.words import Wording, unit_words
from piezod.report.diagnosis import figures, sections
from piezod.report.diagnosis.residual_views import Residuals, memory, owners, views
from piezod.report.diagnosis.spectra import Map, spectrum, time_frequency
from piezod.report.diagnosis.wording import headline
from piezod.report.page import placeholder, write_html, write_text

Array = NDArray[np.float64]

FIGURES = "figures"  # folder of the CSV files, beside the page
MOST_SHOWN = 3  # recordings with figures of their own; the tables have all
TIME_POINTS, LOOP_POINTS = 12_000, 6_000  # of all recordings' curves together: the page stays below 3 MB
SHIFTS = 39  # references for where what is left is


def write_diagnosis_page(path: Path, diagnosis: Diagnosis) -> None:
    """Write the page and, in a folder `figures` beside it, the numbers of every figure as CSV.

    Parameters
    ----------
    path
        The page.
    diagnosis
        What was found and what it rests on.

    Raises
    ------
    ConfigurationError
        A file cannot be written.
    """
    page = _Page(diagnosis)
    body = _body(page)
    for name, text in page.tables.items():
        write_text(path.parent / FIGURES / name, text)
    write_html(path, headline(page.diagnosis.findings), body, page.figures)


@dataclass
class _Page:
    """A page as it grows: its figures and their tables.

    Parameters
    ----------
    diagnosis
        What it shows.
    figures
        By name.
    tables
        Text of every CSV file by its name.
    """

    diagnosis: Diagnosis
    figures: dict[str, Model] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    asked: list[Residuals] = field(init=False)
    within: dict[Place, Residuals] = field(init=False)

    def __post_init__(self) -> None:
        d = self.diagnosis
        self.asked = [
            Residuals(series, given, extended)
            for series, given, extended in zip(d.series, d.base, d.extended, strict=True)
            if series.role == "recording"
        ]
        of_effects = [place for one in d.findings.effects if one.scope == "once" for place in one.where]
        self.within = owners([*d.findings.where, *of_effects], self.asked)

    @property
    def units(self) -> tuple[str, str]:
        """Of command and output, as they are written."""
        return unit_words(self.diagnosis.model.input.unit), unit_words(self.diagnosis.model.output.unit)

    @property
    def extended(self) -> str:
        """What the model after the diagnosis is called."""
        return "extended model" if self.diagnosis.findings.refitted is None else "refitted model"

    @property
    def shown(self) -> list[tuple[int, Residuals]]:
        """Recordings with figures of their own, with their number: those with the largest error."""
        order = sorted(range(len(self.asked)), key=lambda k: -_rms(self.asked[k].before, self.asked[k]))
        return [(k + 1, self.asked[k]) for k in sorted(order[:MOST_SHOWN])]

    def places_in(self, one: Residuals) -> list[Place]:
        """Where the given model is wrong; places in time only if they belong to this recording."""
        places = self.diagnosis.findings.where
        return [place for place in places if self.within.get(place, one) is one]

    def add(self, name: str, plots: Sequence[figure], columns: dict[str, Array], caption: str = "") -> str:
        """Keep figures and their numbers; gives the place of each in the page."""
        if columns:
            self.tables[f"{name}.csv"] = _csv(list(columns), np.column_stack(list(columns.values())).tolist())
        slots = []
        for number, plot in enumerate(plots):
            key = f"{name}_{number}"
            self.figures[key] = plot
            told = f"<figcaption>{html.escape(caption)} {self._link(name)}</figcaption>"
            slots.append(f"<figure>{placeholder(key)}{told if number == len(plots) - 1 else ''}</figure>")
        return "".join(slots)

    def _link(self, name: str) -> str:
        return f"<a href='{FIGURES}/{name}.csv'>{name}.csv</a>" if f"{name}.csv" in self.tables else ""


# ------------------------------------------------------------------------------------------------------ sections


def _body(page: _Page) -> str:
    findings = page.diagnosis.findings
    cards = "".join(sections.card_html(one, findings, _wording(page, page.within)) for one in findings.effects)
    parts = [
        _first_screen(page),
        f"<h2>Measured, given model and {page.extended}</h2>{_curves(page)}",
        f"<h2>What is left, over each driver</h2>{_drivers(page)}",
        f"<h2>What is unexplained, over time and frequency</h2>{_maps(page)}",
        f"<h2>The effects</h2>{cards}" if cards else "",
        f"<h2>Before and after</h2>{sections.held_out_html(findings, _whole(page))}",
        f"<p class='dim'>{html.escape(_HELD_OUT)}</p>",
        f"<h2>What remains unexplained</h2><div class='remains {_open(page)}'>{_remains(page)}</div>",
        f"<h2>Recordings</h2>{sections.recordings_html(findings, page.diagnosis.series)}",
        f"<p class='dim'>piezod {__version__}; findings.json and model.yaml beside this page say it to programs</p>",
    ]
    return "".join(parts)


_HELD_OUT = (
    "Data left out: blocks of the recordings that the fit did not see. The lines below it are errors over each whole "
    "recording, offset adapted; the second of them has seen it."
)


def _first_screen(page: _Page) -> str:
    findings = page.diagnosis.findings
    bars = figures.error_bars(findings, page.extended)
    rows = [[name, f"{value:.9g}"] for name, value, _ in figures.bars_of(findings, page.extended)]
    page.tables["held_out_error.csv"] = _csv(["model", f"error_{findings.unit}"], rows)
    page.tables["effects.csv"] = _effects_csv(page)
    places = [[one.axis, one.low, one.high, one.share, one.p] for one in findings.where]
    page.tables["places.csv"] = _csv(["axis", "low", "high", "share", "p"], places)
    effects = sections.effects_html(findings, _wording(page, page.within))
    return (
        f"{sections.verdict_html(findings)}{sections.chain_html(findings)}"
        f"<div class='first'><div>{effects}</div>{page.add('held_out_error', [bars], {})}</div>"
    )


def _curves(page: _Page) -> str:
    parts, shown = [_not_shown(page)], page.shown
    for number, one in shown:
        lines, columns = figures.time_lines(
            one, TIME_POINTS // len(shown), page.places_in(one), page.units, page.extended
        )
        parts.append(f"<h3>{html.escape(one.series.name)}</h3>{page.add(f'time_{number}', lines, columns, _ZOOM)}")
        loop, columns = figures.loops(one, LOOP_POINTS // len(shown), page.units, page.extended)
        parts.append(f"<div class='pair'>{page.add(f'loop_{number}', loop, columns)}</div>")
    return "".join(parts)


_ZOOM = (
    "Drag to zoom into a span of time, click a name in the legend to hide its curve. Every stretch is drawn by its "
    "smallest and largest value. Hatched: where the given model is significantly wrong; grey: readings not believed. "
    "Axes of residuals leave out the rarest of them, which zooming out shows."
)


def _drivers(page: _Page) -> str:
    unit, places = page.units[1], _places(page)
    slots = [
        page.add(
            f"left_over_{view.name}",
            *figures.driver_figure(view, page.places_in(view.only) if view.only else places, unit, page.extended),
        )
        for view in views(page.asked, page.shown, page.units)
    ]
    slots.append(page.add("left_over_memory", *figures.memory_figure(memory(page.asked), places, page.extended)))
    return f"<p class='dim'>{_DRIVERS}</p><div class='three'>{''.join(slots)}</div>"


_DRIVERS = (
    "Measured less model: mean in each cell, solid while the command rises, dashed while it falls; the band is one "
    "standard deviation of all readings in the cell. A flat line at 0 with a narrow band is noise. Hatched: "
    "places in which the given model is significantly wrong (false alarm at most 5 % over all places together)."
)


def _maps(page: _Page) -> str:
    floor = page.diagnosis.findings.floor
    before = [time_frequency(one.before, one.series.dt_s, floor) for _, one in page.shown]
    after = [time_frequency(one.after, one.series.dt_s, floor) for _, one in page.shown]
    scale = figures.colour_scale([*before, *after])
    parts = [f"<p class='dim'>{_MAPS}</p>"]
    for (number, one), was, now in zip(page.shown, before, after, strict=True):
        start_s = one.series.start_s
        pair = [
            figures.map_figure(was, start_s, "Before: given model", scale),
            figures.map_figure(now, start_s, f"After: {page.extended}", scale),
        ]
        page.tables[f"map_{number}.csv"] = _map_csv(was, now, start_s)
        parts.append(f"<h3>{html.escape(one.series.name)}</h3>" if len(page.asked) > 1 else "")
        parts.append(f"<div class='pair'>{page.add(f'map_{number}', pair, {})}</div>{_spectrum(page, number, one)}")
    return "".join(parts)


_MAPS = (
    "Power of what is left in decibels over the noise floor, spread evenly over all frequencies; both maps of a "
    "recording on one scale. Light: no more than noise."
)


def _spectrum(page: _Page, number: int, one: Residuals) -> str:
    dt_s = one.series.dt_s
    frequency_Hz, before = spectrum(one.before, dt_s)
    _, after = spectrum(one.after, dt_s)
    floor = page.diagnosis.findings.floor * float(np.sqrt(2.0 * dt_s))
    plot, columns = figures.spectrum_figure(
        (frequency_Hz, before, after), floor, _places(page), page.units[1], page.extended
    )
    return page.add(f"spectrum_{number}", plot, columns)


def _remains(page: _Page) -> str:
    left = _left(page)
    return sections.remains_html(page.diagnosis.findings, left, _wording(page, owners(left, page.asked)))


def _left(page: _Page) -> list[Place]:
    """Where what is left is more than noise; not asked where the verdict says that nothing is."""
    if not _open(page):
        return []
    series, left, modelled = zip(*((one.series, one.after, one.extended) for one in page.asked), strict=True)
    found = locate(series, left, modelled, shifts=SHIFTS)
    return [Place(one.axis, one.low, one.high, one.share, one.p) for one in found]


def _open(page: _Page) -> str:
    """Whether something is missing that has no name, as a class of style."""
    return "open" if page.diagnosis.findings.verdict in ("partly_explained", "unexplained") else ""


def _not_shown(page: _Page) -> str:
    more = len(page.asked) - len(page.shown)
    return f"<p>The {MOST_SHOWN} recordings with the largest error; {more} more are in the tables.</p>" if more else ""


# ------------------------------------------------------------------------------------------------------- numbers


def _places(page: _Page) -> tuple[Place, ...]:
    return page.diagnosis.findings.where


def _wording(page: _Page, within: Mapping[Place, Residuals]) -> Wording:
    """Units, and with several recordings the one that each place in time is in."""
    several = len(page.asked) > 1
    return Wording(*page.units, {place: one.series.name for place, one in within.items()} if several else {})


def _whole(page: _Page) -> list[tuple[str, float, float]]:
    return [(one.series.name, _rms(one.before, one), _rms(one.after, one)) for one in page.asked]


def _rms(left: Array, one: Residuals) -> float:
    return float(np.sqrt(np.mean(np.square(left[one.series.counts]))))


def _effects_csv(page: _Page) -> str:
    header = ["effect", "scope", "confidence", "parameter", "value", "low", "high", "unit", "before", "after"]
    rows = [
        [one.name, one.scope, one.confidence, name, v.value, v.low, v.high, v.unit, one.before, one.after]
        for one in page.diagnosis.findings.effects
        for name, v in one.parameters.items()
    ]
    return _csv(header, rows)


def _map_csv(before: Map, after: Map, start_s: float) -> str:
    times_s = start_s + 0.5 * (before.time_s[:-1] + before.time_s[1:])
    middles_Hz = np.sqrt(before.frequency_Hz[:-1] * before.frequency_Hz[1:])
    frequency_Hz, time_s = np.meshgrid(middles_Hz, times_s, indexing="ij")
    levels = [one.level_dB.ravel().round(1) for one in (before, after)]
    rows = np.column_stack((time_s.ravel(), frequency_Hz.ravel(), *levels)).tolist()
    return _csv(["time_s", "frequency_Hz", "before_dB", "after_dB"], rows)


def _csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([f"{cell:.9g}" if isinstance(cell, float) else cell for cell in row] for row in rows)
    return out.getvalue()
