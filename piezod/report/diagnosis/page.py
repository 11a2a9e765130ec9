"""The page of a diagnosis: effects found, their places and confidence first, then the evidence."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bokeh.model import Model
from bokeh.plotting import figure

from piezod import __version__
from piezod.arrays import Array
from piezod.diagnose.findings import Place
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.localisation.locate import locate
from piezod.diagnose.verdict.words import Wording, unit_words
from piezod.report.diagnosis import sections
from piezod.report.diagnosis.csv_tables import csv_text, effects_csv, map_csv, places_csv
from piezod.report.diagnosis.figures.curves import error_bars, held_out_errors, loop_figures, time_figures
from piezod.report.diagnosis.figures.drivers import driver_figure, memory_figure
from piezod.report.diagnosis.figures.law import law_figure
from piezod.report.diagnosis.figures.spectrum import map_figure, power_scale, spectrum_figure
from piezod.report.diagnosis.residual.residuals import Residuals, recordings_of_places
from piezod.report.diagnosis.residual.spectra import spectrum, time_frequency
from piezod.report.diagnosis.residual.views import memory, views
from piezod.report.diagnosis.wording import headline, law_sentence
from piezod.report.next_step import NextStep
from piezod.report.page import fold_html, next_step_html, placeholder, write_html
from piezod.runtime.files import written

FIGURES = "figures"  # folder of the CSV files, in the folder of the page
MOST_SHOWN = 3  # recordings with figures of their own; the tables contain all recordings
TIME_POINTS, LOOP_POINTS = 12_000, 6_000  # of all recordings together, so that the page stays below 3 MB
SHIFTS = 39  # references for the p-value of a remaining place


def write_diagnosis_page(path: Path, diagnosis: Diagnosis, step: NextStep | None = None) -> None:
    """Write the page and, in the folder `figures` next to the page, the data of every figure as CSV.

    Parameters
    ----------
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        A file cannot be written.
    """
    page = _Page(diagnosis, step)
    body = _body(page)
    for name, text in page.tables.items():
        written(path.parent / FIGURES / name, text, parents=True)
    write_html(path, headline(page.diagnosis.findings), body, page.figures)


@dataclass
class _Page:
    """A page under construction, with its figures and tables.

    Parameters
    ----------
    step
        Next step of the command; None: the page has none.
    tables
        Text of each CSV file by its name.
    """

    diagnosis: Diagnosis
    step: NextStep | None = None
    figures: dict[str, Model] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    recordings: list[Residuals] = field(init=False)
    recording_of: dict[Place, Residuals] = field(init=False)

    def __post_init__(self) -> None:
        d = self.diagnosis
        self.recordings = [
            Residuals(series, given, extended)
            for series, given, extended in zip(d.series, d.base, d.extended, strict=True)
            if series.role == "recording"
        ]
        of_effects = [place for finding in d.findings.effects if finding.scope == "once" for place in finding.where]
        self.recording_of = recordings_of_places([*d.findings.where, *of_effects], self.recordings)

    @property
    def units(self) -> tuple[str, str]:
        """Units of command and output, as text."""
        return unit_words(self.diagnosis.model.input.unit), unit_words(self.diagnosis.model.output.unit)

    @property
    def extended(self) -> str:
        """Name of the model after the diagnosis."""
        return "extended model" if self.diagnosis.findings.refitted is None else "refitted model"

    @property
    def shown(self) -> list[tuple[int, Residuals]]:
        """Number and residuals of the recordings with the largest errors, which have separate figures."""
        order = sorted(range(len(self.recordings)), key=lambda k: -_rms(self.recordings[k].before, self.recordings[k]))
        return [(k + 1, self.recordings[k]) for k in sorted(order[:MOST_SHOWN])]

    def places_in(self, recording: Residuals) -> list[Place]:
        """Places in which the given model is wrong, without places in the time of other recordings."""
        places = self.diagnosis.findings.where
        return [place for place in places if self.recording_of.get(place, recording) is recording]

    def add(self, name: str, plots: Sequence[figure], columns: Mapping[str, Array], caption: str = "") -> str:
        """Register figures and the table of their data.

        Parameters
        ----------
        name
            Name of the figures and of their CSV file.
        plots
            Figures, from top to bottom or from left to right.
        columns
            Columns of equal length; empty if the table is already registered.
        caption
            Text below the last figure.

        Returns
        -------
        str
            HTML with a placeholder for each figure.
        """
        if columns:
            self.tables[f"{name}.csv"] = csv_text(list(columns), np.column_stack(list(columns.values())).tolist())
        parts = []
        for number, plot in enumerate(plots):
            key = f"{name}_{number}"
            self.figures[key] = plot
            below = f"<figcaption>{html.escape(caption)} {self._link(name)}</figcaption>"
            parts.append(f"<figure>{placeholder(key)}{below if number == len(plots) - 1 else ''}</figure>")
        return "".join(parts)

    def _link(self, name: str) -> str:
        return f"<a href='{FIGURES}/{name}.csv'>{name}.csv</a>" if f"{name}.csv" in self.tables else ""


# ------------------------------------------------------------------------------------------------------ sections


def _body(page: _Page) -> str:
    findings = page.diagnosis.findings
    wording = _wording(page, page.recording_of)
    cards = "".join(sections.card_html(effect, findings, wording) for effect in findings.effects)
    rows = [(r.series.name, _rms(r.before, r), _rms(r.after, r)) for r in page.recordings]
    errors = f"{sections.held_out_html(findings, rows)}<p class='dim'>{html.escape(_HELD_OUT)}</p>"
    remains = f"<div class='remains {_open(page)}'>{_remains(page)}</div>"
    parts = [
        _first_screen(page),
        fold_html(f"Measured, given model and {page.extended}", _curves(page)),
        fold_html("Residual over each driver", _drivers(page)),
        fold_html("Residual over time and frequency", _maps(page)),
        fold_html("Effects found", cards),
        fold_html("Law without a name", _law(page)),
        fold_html("Errors before and after the diagnosis", errors),
        fold_html("What remains unexplained", remains),
        fold_html("Recordings", sections.recordings_html(findings, page.diagnosis.series)),
        f"<p class='dim'>piezod {__version__}. For programs: findings.json and model.yaml beside this page.</p>",
    ]
    return "".join(parts)


def _law(page: _Page) -> str:
    """The unnamed law: its drivers and its curves."""
    finding, law = page.diagnosis.findings.law, page.diagnosis.model.unnamed_law
    if finding is None or law is None:
        return ""
    plot, columns = law_figure(law, page.units)
    sentence = html.escape(law_sentence(finding, page.diagnosis.findings))
    figure = page.add("unnamed_law", [plot], columns, _GAIN if law.gain else _DYNAMICS if law.linear else _LAW)
    return f"<p>{sentence}</p>{figure}"


_GAIN = (
    "Gain of what the reading has moved from its start, while the drivers keep their values and memories have settled."
)
_DYNAMICS = "What the dynamics add to the reading for a sine of its driver, for each unit of the amplitude."
_LAW = "What the law adds to the reading while its drivers keep their values, after its memories have settled."

_HELD_OUT = (
    "Errors that piezod simulate leaves with the given and the written model, about their mean. The errors of each "
    "effect, without and with it, are those of blocks of the recordings that the fit did not use."
)


def _first_screen(page: _Page) -> str:
    findings = page.diagnosis.findings
    rows = [[name, f"{error:.9g}"] for name, error, _ in held_out_errors(findings, page.extended)]
    page.tables["held_out_error.csv"] = csv_text(["model", f"error_{findings.unit}"], rows)
    page.tables["effects.csv"] = effects_csv(findings)
    page.tables["places.csv"] = places_csv(findings)
    effects = sections.effects_html(findings, _wording(page, page.recording_of))
    bars = page.add("held_out_error", [error_bars(findings, page.extended)], {})
    return (
        f"{sections.verdict_html(findings)}{next_step_html(page.step)}{sections.chain_html(findings)}"
        f"<div class='first'><div>{effects}</div>{bars}</div>"
    )


def _curves(page: _Page) -> str:
    parts, shown = [_not_shown(page)], page.shown
    for number, recording in shown:
        points, places = TIME_POINTS // len(shown), page.places_in(recording)
        plots, columns = time_figures(recording, points, places, page.units, page.extended)
        heading = html.escape(recording.series.name)
        parts.append(f"<h3>{heading}</h3>{page.add(f'time_{number}', plots, columns, _ZOOM)}")
        plots, columns = loop_figures(recording, LOOP_POINTS // len(shown), page.units, page.extended)
        parts.append(f"<div class='pair'>{page.add(f'loop_{number}', plots, columns)}</div>")
    return "".join(parts)


_ZOOM = (
    "Drag to zoom in on a span of time. Click a name in the legend to hide its curve. Long curves are thinned: each "
    "segment is drawn by its smallest and largest value. Hatched: the given model is significantly wrong. Grey: "
    "rejected readings. The axes of residuals exclude outliers; zoom out to see them."
)


def _drivers(page: _Page) -> str:
    unit, places = page.units[1], page.diagnosis.findings.where
    figures = [
        page.add(
            f"left_over_{view.driver.name}",
            *driver_figure(view, page.places_in(view.only) if view.only else places, unit, page.extended),
        )
        for view in views(page.recordings, page.shown, page.units)
    ]
    figures.append(page.add("left_over_memory", *memory_figure(memory(page.recordings), places, page.extended)))
    return f"<p class='dim'>{_DRIVERS}</p><div class='three'>{''.join(figures)}</div>"


_DRIVERS = (
    "A driver is a quantity that the error may depend on. Curves: mean of measured minus model in each cell; solid for "
    "a rising command, dashed for a falling command. Band: one standard deviation of the readings in the cell. Noise "
    "alone gives a flat line at 0 with a narrow band. Hatched: the given model is significantly wrong. The probability "
    "of a false alarm, over all places together, is at most 5 %."
)


def _maps(page: _Page) -> str:
    floor = page.diagnosis.findings.floor
    before = [time_frequency(recording.before, recording.series.dt_s, floor) for _, recording in page.shown]
    after = [time_frequency(recording.after, recording.series.dt_s, floor) for _, recording in page.shown]
    scale = power_scale([*before, *after])
    parts = [f"<p class='dim'>{_MAPS}</p>"]
    for (number, recording), power_before, power_after in zip(page.shown, before, after, strict=True):
        start_s = recording.series.start_s
        pair = [
            map_figure(power_before, start_s, "Before: given model", scale),
            map_figure(power_after, start_s, f"After: {page.extended}", scale),
        ]
        page.tables[f"map_{number}.csv"] = map_csv(power_before, power_after, start_s)
        parts.append(f"<h3>{html.escape(recording.series.name)}</h3>" if len(page.recordings) > 1 else "")
        maps = page.add(f"map_{number}", pair, {})
        parts.append(f"<div class='pair'>{maps}</div>{_spectrum(page, number, recording)}")
    return "".join(parts)


_MAPS = (
    "Power of the residual in decibels above the noise floor, for noise of equal power at all frequencies. All maps "
    "have the same colour scale. Light: noise only."
)


def _spectrum(page: _Page, number: int, recording: Residuals) -> str:
    dt_s = recording.series.dt_s
    frequency_Hz, before = spectrum(recording.before, dt_s)
    _, after = spectrum(recording.after, dt_s)
    floor = page.diagnosis.findings.floor * float(np.sqrt(2.0 * dt_s))
    places = page.diagnosis.findings.where
    plots, columns = spectrum_figure((frequency_Hz, before, after), floor, places, page.units[1], page.extended)
    return page.add(f"spectrum_{number}", plots, columns)


def _remains(page: _Page) -> str:
    places = _remaining_places(page)
    wording = _wording(page, recordings_of_places(places, page.recordings))
    return sections.remains_html(page.diagnosis.findings, places, wording)


# ------------------------------------------------------------------------------------------------------- numbers


def _remaining_places(page: _Page) -> list[Place]:
    """Places in which the extended model is significantly wrong; none if the verdict reports no unknown effect."""
    if not _open(page):
        return []
    series, residuals, modelled = zip(*((r.series, r.after, r.extended) for r in page.recordings), strict=True)
    places = locate(series, residuals, modelled, shifts=SHIFTS)
    return [Place(place.axis, place.low, place.high, place.share, place.p) for place in places]


def _open(page: _Page) -> str:
    """CSS class of the last section: `open` if an unknown effect remains, else empty."""
    return "open" if page.diagnosis.findings.verdict in ("partly_explained", "unexplained") else ""


def _not_shown(page: _Page) -> str:
    more = len(page.recordings) - len(page.shown)
    text = f"Shown: the {MOST_SHOWN} recordings with the largest error; {more} more are in the tables."
    return f"<p>{text}</p>" if more else ""


def _wording(page: _Page, recording_of: Mapping[Place, Residuals]) -> Wording:
    """Units and, with several recordings, the name of the recording of each place in time."""
    several = len(page.recordings) > 1
    return Wording(*page.units, {place: r.series.name for place, r in recording_of.items()} if several else {})


def _rms(residual: Array, recording: Residuals) -> float:
    return float(np.sqrt(np.mean(np.square(residual[recording.series.counts]))))
