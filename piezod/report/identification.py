"""Result of an identification as JSON, as text, and as a page."""

import html
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from piezod.diagnose.verdict.words import unit_words
from piezod.identify.identification import Identification
from piezod.identify.order import Candidate
from piezod.identify.simulation import simulate
from piezod.identify.tables import OperatorRow, dead_zone_rows, play_rows
from piezod.model import Model, without_inverse
from piezod.recording import Recording
from piezod.report.dynamics import dynamics
from piezod.report.figures.layout import decimated, finish_figure, labelled_figure
from piezod.report.figures.thinning import robust_range
from piezod.report.next_step import NextStep
from piezod.report.next_step.of_models import after_identify
from piezod.report.page import Part, axis_label, table_html, write_page
from piezod.report.style import BLUE, GREY, ORANGE

START_WINDOW = 2000  # samples at the start that estimate the initial state of a recording


def identification_as_dict(identification: Identification) -> dict[str, Any]:
    """Return the result for JSON.

    Parameters
    ----------
    identification
        Model, orders and errors of an identification.
    """
    fit = identification.model.provenance.fit
    chosen, before = identification.chosen, identification.before_pruning
    assert chosen.fit is not None
    return {
        "schema": "piezod.identification/1",
        "orders": {"plays": chosen.plays, "dead_zones": chosen.zones},
        "orders_before_pruning": {"plays": before.plays, "dead_zones": before.zones},
        "unit": identification.model.output.unit,
        "range": identification.model.output.high - identification.model.output.low,
        "fit": {key.removesuffix("_fit"): value for key, value in fit if key.endswith("_fit")},
        "held_out": {key.removesuffix("_held_out"): value for key, value in fit if key.endswith("_held_out")},
        "condition": chosen.fit.condition,
        "verdict": identification.verdict,
        "explained": identification.explained,
        "noise": None if identification.noise is None else asdict(identification.noise),
        "linear_dynamics": _dynamics_as_dict(identification.model),
        "notes": identification.notes,
        "candidates": [
            {"plays": c.plays, "dead_zones": c.zones, "rms_fit": c.rms_fit, "rms_held_out": c.rms_held_out}
            for c in identification.candidates
        ],
    }


def _dynamics_as_dict(model: Model) -> dict[str, Any] | None:
    """Modes and lags parallel to the hysteresis; None: there are none."""
    law = model.unnamed_law
    if law is None:
        return None
    modes = [{"frequency_Hz": mode.frequency_Hz, "damping_ratio": mode.damping_ratio} for mode in law.modes]
    return {"modes": modes, "lags_s": [memory_s for memory_s in law.memories_s if memory_s > 0.0]}


def identification_text(identification: Identification) -> str:
    """Orders, errors, operators, notes and verdict.

    Parameters
    ----------
    identification
        Model, orders and errors of an identification.
    """
    model, chosen = identification.model, identification.chosen
    lines = []
    if identification.candidates:
        lines.append(f"held-out rms error [{model.output.unit}] for n plays (rows) and m dead zones (columns):")
        orders = _order_rows(identification.candidates, identification.before_pruning)
        lines += ["  " + "".join(cell.rjust(11) for cell in row) for row in orders]
    assert chosen.fit is not None
    lines.append(f"{_orders(identification)}; condition number {chosen.fit.condition:.0f}")
    rows = [("", "fit", "held out"), *figure_rows(identification)]
    lines += [f"{name:24}{fit:>12}{held_out:>12}" for name, fit, held_out in rows]
    for title, operators in (
        ("plays", play_rows(model.hysteresis)),
        ("dead zones", dead_zone_rows(model.hysteresis)),
    ):
        significant = [str(operator.index) for operator in operators if operator.matters]
        lines.append(
            f"{title}: {len(operators)}, of which {len(significant)} are significant: {', '.join(significant)}"
        )
    return "\n".join([*lines, *(f"note: {note}" for note in identification.notes), identification.verdict])


def next_after(identification: Identification, recordings: Sequence[Path], model: Path) -> NextStep:
    """Next step after an identification.

    Parameters
    ----------
    recordings, model
        Files of the recordings and of the model.
    """
    noise, plant = identification.noise, identification.model
    return after_identify(
        recordings,
        model,
        useful=identification.useful,
        explained=identification.explained,
        noises=None if noise is None or not noise.rms else identification.chosen.rms_held_out / noise.rms,
        drives_a_bench=(plant.input.unit, plant.output.unit) == ("V", "N") and not plant.output.channel.startswith("-"),
        refused=without_inverse(plant),
    )


def write_identification_page(
    path: Path, identification: Identification, recordings: Sequence[Recording], step: NextStep | None = None
) -> None:
    """Write the page: held-out error, errors, curves of each recording, orders, and operators.

    Parameters
    ----------
    recordings
        Recordings whose curves are drawn.
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    model, chosen = identification.model, identification.chosen
    unit = unit_words(model.output.unit)
    words = identification.verdict
    verdict = f"{words[0].upper()}{words[1:]}. The model has {chosen.plays} plays and {chosen.zones} dead zones."
    heading = f"Identification: {_quantity(model.input.channel)} to {_quantity(model.output.channel)}"
    parts: list[Part] = [table_html(["", "fit", "held out"], figure_rows(identification))]
    if identification.notes:
        notes = "".join(f"<li>{html.escape(without_folders(note, recordings))}</li>" for note in identification.notes)
        parts.append(f"<h2>Notes</h2><ul>{notes}</ul>")
    for recording in recordings:
        parts.extend(_curves(identification, recording))
    if identification.candidates:
        orders = _order_rows(identification.candidates, identification.before_pruning)
        parts.append(f"<h2>Held-out rms error [{unit}] for n plays and m dead zones; *: selected</h2>")
        parts.append(table_html(orders[0], orders[1:]))
    command = unit_words(model.input.unit)
    for title, operators, units in (
        ("Plays", play_rows(model.hysteresis), (command, "1", command, "1")),
        ("Dead zones", dead_zone_rows(model.hysteresis), (command, f"{unit}/{command}", unit, f"{command}/{unit}")),
    ):
        significant = sum(operator.matters for operator in operators)
        summary = f"{title}: {len(operators)}, of which {significant} are significant"
        parts.append(f"<details><summary>{summary}</summary>{_operator_table(operators, units)}</details>")
    write_page(path, "Identification", (heading, verdict), parts, step)


def without_folders(text: str, recordings: Sequence[Recording]) -> str:
    """A text with the names of the recordings' files instead of their paths.

    Parameters
    ----------
    text
        One line.
    recordings
        Recordings that it may name.
    """
    for recording in recordings:
        text = text.replace(recording.source, Path(recording.source).name)
    return text


def _quantity(channel: str) -> str:
    return channel.rpartition("_")[0].replace("_", " ") or channel


def _curves(identification: Identification, recording: Recording) -> list[Part]:
    """Heading and figures of a recording: curves over time, hysteresis loop, residual, and dynamics."""
    model = identification.model
    u, y = recording.channel(model.input.channel), recording.channel(model.output.channel)
    modelled, start = simulate(model, recording, START_WINDOW)
    time_s = recording.time_s
    command, output = axis_label(model.input.channel), axis_label(model.output.channel)
    over_time = labelled_figure("Output over time", "time [s]", output, 300)
    over_time.line(decimated(time_s), decimated(y), color=GREY, line_width=3, legend_label="measured")
    over_time.line(decimated(time_s), decimated(modelled), color=BLUE, legend_label="modelled")
    inputs = labelled_figure("Input over time", "time [s]", command, 200, x_range=over_time.x_range)
    inputs.line(decimated(time_s), decimated(u), color=ORANGE, legend_label="input")
    loop = labelled_figure("Hysteresis curve", command, output, 300)
    loop.line(decimated(u), decimated(y), color=GREY, line_width=3, legend_label="measured")
    loop.line(decimated(u), decimated(modelled), color=BLUE, legend_label="modelled")
    residual = labelled_figure(
        "Measured less modelled",
        "time [s]",
        f"residual [{unit_words(model.output.unit)}]",
        200,
        x_range=over_time.x_range,
        y_range=robust_range(y - modelled),
    )
    residual.line(decimated(time_s), decimated(y - modelled), color=ORANGE, legend_label="residual")
    note = f"{start}; the residual's axis excludes its outliers"
    head = f"<h2>{html.escape(Path(recording.source).name)}</h2><p class='dim'>{html.escape(note)}</p>"
    parts = dynamics(u, y, modelled, recording.dt_s, unit_words(model.output.unit), identification.noise)
    return [
        head,
        [finish_figure(over_time), finish_figure(loop)],
        [finish_figure(inputs)],
        [finish_figure(residual)],
        *parts,
    ]


def figure_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Figures of merit in words, of the fit and of held-out data.

    Parameters
    ----------
    identification
        Model, orders and errors of an identification.
    """
    fit, unit = identification.model.provenance.fit, unit_words(identification.model.output.unit)
    span = identification.model.output.high - identification.model.output.low
    pairs = (
        (f"rms error [{unit}]", fit.rms_fit, fit.rms_held_out),
        ("rms error [% of range]", _percent(fit.rms_fit, span), _percent(fit.rms_held_out, span)),
        (f"max error [{unit}]", fit.max_fit, fit.max_held_out),
        ("fit, NRMSE [%]", fit.nrmse_percent_fit, fit.nrmse_percent_held_out),
        ("max hysteresis [%]", fit.max_hysteresis_percent_fit, fit.max_hysteresis_percent_held_out),
        ("  of it not modelled [%]", fit.remaining_hysteresis_percent_fit, fit.remaining_hysteresis_percent_held_out),
    )
    return [(name, *("-" if value is None else f"{value:.4g}" for value in values)) for name, *values in pairs]


def _orders(identification: Identification) -> str:
    selected, chosen = identification.before_pruning, identification.chosen
    if not identification.candidates:
        return f"n = {chosen.plays} plays, m = {chosen.zones} dead zones, the fewest that fit as well as fine tables"
    text = f"selected (*): n = {selected.plays}, m = {selected.zones}"
    if (chosen.plays, chosen.zones) != (selected.plays, selected.zones):
        text += f"; without insignificant operators: n = {chosen.plays}, m = {chosen.zones}"
    return text


def _percent(value: float | None, span: float) -> float:
    return 100.0 * (value or 0.0) / span


def _order_rows(candidates: Sequence[Candidate], chosen: Candidate) -> list[list[str]]:
    zones = sorted({candidate.zones for candidate in candidates})
    plays = sorted({candidate.plays for candidate in candidates})
    by_order = {(candidate.plays, candidate.zones): candidate for candidate in candidates}
    rows = [["n \\ m", *(str(m) for m in zones)]]
    for n in plays:
        cells = []
        for m in zones:
            candidate = by_order[n, m]
            mark = "*" if candidate is chosen else ""
            cells.append(f"{mark}{candidate.rms_held_out:.4g}" if candidate.fit is not None else "-")
        rows.append([str(n), *cells])
    return rows


def _operator_table(operators: Sequence[OperatorRow], units: tuple[str, str, str, str]) -> str:
    names = ("threshold r", "weight w", "inverse r'", "inverse w'")
    header = ["i", *(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)), ""]
    rows = []
    for operator in operators:
        values = (operator.threshold, operator.weight, operator.inverse_threshold, operator.inverse_weight)
        remark = "" if operator.matters else "insignificant"
        rows.append([str(operator.index), *(f"{value:.4g}" for value in values), remark])
    return table_html(header, rows)
