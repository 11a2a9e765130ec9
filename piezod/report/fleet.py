"""Benches of an archive as text, as one page for all of them, and as a page for each with its recordings."""

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, HoverTool
from bokeh.plotting import figure

from piezod.diagnose.verdict.words import PER_CENT
from piezod.history.archive_run import Diagnosed
from piezod.history.fleet import BenchState, Fleet
from piezod.history.parameters import Key
from piezod.history.words import interval_text, wording_of
from piezod.report.figures.layout import apply_layout
from piezod.report.history import value_range, write_history_page
from piezod.report.next_step import NextStep
from piezod.report.next_step.of_studies import UNFINISHED, after_fleet
from piezod.report.page import Part, table_html, write_page
from piezod.report.style import BLUE, GREY, ORANGE
from piezod.report.text_table import text_table

PAGE, BENCH_PAGE = "fleet.html", "history.html"
PANEL_HEIGHT = 230  # [px]
NONE, MARK = "-", "*"


def next_after(fleet: Fleet, archives: Sequence[Path], folder: Path) -> NextStep:
    """Next step after an archive: the first recording that failed, else the first bench that is not explained.

    Parameters
    ----------
    archives, folder
        Archives, and the folder of the pages.
    """
    failed = next((one.recording.path for bench in fleet.benches for one in bench.failed), None)
    unfinished = next(
        ((bench.name, bench.run.model_paths[-1]) for bench in fleet.benches if bench.verdict in UNFINISHED), None
    )
    return after_fleet(archives, folder, recordings=fleet.recordings, unfinished=unfinished, failed=failed)


def fleet_text(fleet: Fleet) -> str:
    """Table of the benches, the verdict, and the outstanding benches."""
    outstanding = [f"stands out: {line}" for line in fleet.stands_out]
    return "\n".join([*text_table(fleet_rows(fleet), left_aligned=2), fleet.verdict, *outstanding])


def fleet_rows(fleet: Fleet) -> list[list[str]]:
    """Table with a row for each bench; a parameter unlike the others is marked."""
    units = {key: bench.parameters[key].unit for bench in fleet.benches for key in bench.parameters}
    head = ["bench", "newest verdict", "recordings", "damaged", "models"]
    head += [key.heading(units[key]) for key in fleet.keys]
    outlying = {key: fleet.outlying(key) for key in fleet.keys}
    return [head] + [
        [
            bench.name,
            bench.verdict,
            str(len(bench.run.done)),
            str(len(bench.failed)),
            str(len(bench.timeline.steps)),
            *(_cell(bench, key, marked=bench.name in outlying[key]) for key in fleet.keys),
        ]
        for bench in fleet.benches
    ]


def write_fleet_pages(folder: Path, fleet: Fleet, step: NextStep | None = None) -> None:
    """Write the page of the fleet with its next step, and a page for each bench in the folder of its name.

    Raises
    ------
    ConfigurationError
        A file cannot be written.
    """
    for bench in fleet.benches:
        page = folder / bench.name / BENCH_PAGE
        write_history_page(
            page, bench.timeline, bench.words, recordings_html(bench), trends=bench.trends, estimates=bench.estimates
        )
    rows = fleet_rows(fleet)
    outstanding = "".join(f"<li>{html.escape(line)}</li>" for line in fleet.stands_out)
    links = "".join(
        f"<li><a href='{html.escape(bench.name)}/{BENCH_PAGE}'>{html.escape(bench.name)}</a>: "
        f"{html.escape(bench.words)}</li>"
        for bench in fleet.benches
    )
    panels = [_panel(fleet, key) for key in fleet.keys]
    parts: list[Part] = [
        f"<h2>What stands out</h2><ul>{outstanding}</ul>" if outstanding else "",
        "<h2>Benches by parameters</h2>",
        *(panels[k : k + 3] for k in range(0, len(panels), 3)),
        "<p class='dim'>Bars: 95 % intervals. Line: median. Orange: unlike the other benches.</p>",
        table_html(rows[0], rows[1:]),
        f"<h2>Each bench</h2><ul>{links}</ul>",
    ]
    head = "Fleet", f"{fleet.verdict[0].upper()}{fleet.verdict[1:]}."
    write_page(folder / PAGE, "Fleet", head, parts, step)


def recordings_html(bench: BenchState) -> str:
    """Table of the recordings of a bench with their verdicts."""
    if not bench.run.done:
        return ""
    head = "".join(f"<th>{name}</th>" for name in ("recording", "date (UTC)", "verdict", "in words"))
    rows = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in _recording_row(diagnosed)) + "</tr>"
        for diagnosed in bench.run.done
    )
    return f"<h2>Recordings</h2><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _recording_row(diagnosed: Diagnosed) -> tuple[str, str, str, str]:
    name, findings = diagnosed.recording.path.name, diagnosed.findings
    date = NONE if diagnosed.recording.date is None else f"{diagnosed.recording.date:%Y-%m-%d %H:%M}"
    if findings is None:
        return name, date, "damaged", diagnosed.failed or ""
    return name, date, findings["verdict"].replace("_", " "), findings["words"]


def _cell(bench: BenchState, key: Key, *, marked: bool) -> str:
    value = bench.parameters.get(key)
    if value is None:
        return NONE
    text = interval_text(key, value, bench.timeline.steps[-1].entry.model)
    return f"{MARK} {text}" if marked else text


def _panel(fleet: Fleet, key: Key) -> figure:
    """Value of a parameter for each bench that has it, with interval bars; values unlike the others are orange."""
    benches = [bench for bench in fleet.benches if key in bench.parameters]
    outlying, unit = fleet.outlying(key), benches[0].parameters[key].unit
    factor = PER_CENT if unit == "1" else 1.0
    values = [bench.parameters[key] for bench in benches]
    ends = np.array([[value.low, value.high] for value in values]) * factor
    middle = factor * float(np.median([value.value for value in values]))
    source = ColumnDataSource(
        {
            "bench": [bench.name for bench in benches],
            "value": [factor * value.value for value in values],
            "low": ends[:, 0],
            "high": ends[:, 1],
            "colour": [ORANGE if bench.name in outlying else BLUE for bench in benches],
        }
    )
    shown = "%" if unit == "1" else wording_of(benches[0].timeline.steps[-1].entry.model).unit(unit)
    plot = figure(
        title=f"{key.heading(unit)} [{shown}]",
        x_range=FactorRange(factors=[bench.name for bench in fleet.benches]),
        y_range=value_range(ends),
        height=PANEL_HEIGHT,
    )
    plot.hspan(y=[middle], line_color=GREY)
    plot.segment("bench", "low", "bench", "high", source=source, color="colour", line_width=3, alpha=0.6)
    plot.scatter("bench", "value", source=source, color="colour", size=8)
    plot.xaxis.major_label_orientation = 0.8
    plot.add_tools(HoverTool(tooltips=[("bench", "@bench"), ("value", "@value"), ("interval", "@low to @high")]))
    return apply_layout(plot)
