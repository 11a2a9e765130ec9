"""HTML of a result for a notebook: a verdict, a table, notes, and a picture that needs no script."""

import html
from collections.abc import Mapping, Sequence

import numpy as np

from piezod.arrays import Array
from piezod.report.page import axis_label
from piezod.report.style import BLUE, GREY

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 560, 240, 60, 34, 22  # of the picture [px]
MOST_POINTS = 1500
TICKS = 5


def result_html(verdict: str, rows: Sequence[Sequence[str]], notes: Sequence[str], picture: str) -> str:
    """Verdict, table, picture (SVG) and notes; `rows` begins with the header, without rows there is no table."""
    words = html.escape(f"{verdict[:1].upper()}{verdict[1:]}.")
    parts = [f"<p><strong>{words}</strong></p>"]
    if rows:
        head, *body = [[html.escape(cell) for cell in row] for row in rows]
        lines = ["".join(f"<th>{cell}</th>" for cell in head)]
        lines += ["".join(f"<td style='text-align:left'>{cell}</td>" for cell in row) for row in body]
        parts.append("<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>")
    parts.append(picture)
    if notes:
        items = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
        parts.append(f"<details><summary>{len(notes)} notes</summary><ul>{items}</ul></details>")
    return "".join(parts)


def curves_svg(x: Array, curves: Mapping[str, Array], labels: tuple[str, str]) -> str:
    """A picture of up to two curves over x.

    Parameters
    ----------
    x, curves
        Abscissa and named curves, each shape (N,); nan makes a gap.
    labels
        Names of both axes with their units, such as `voltage_V`.
    """
    every = max(1, -(-x.size // MOST_POINTS))
    x = x[::every]
    shown = {name: y[::every] for name, y in curves.items()}
    low_x, high_x = _limits([x])
    low_y, high_y = _limits(list(shown.values()))

    def across(value: float) -> float:
        return LEFT + (WIDTH - LEFT - 10) * (value - low_x) / (high_x - low_x)

    def down(value: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high_y - value) / (high_y - low_y)

    parts = [f"<rect x='{LEFT}' y='{TOP}' width='{WIDTH - LEFT - 10}' height='{HEIGHT - TOP - BOTTOM}' fill='none' "]
    parts[0] += "stroke='currentColor' stroke-opacity='0.3'/>"
    ticks_x, ticks_y = np.linspace(low_x, high_x, TICKS), np.linspace(low_y, high_y, TICKS)
    parts += [_text(across(value), HEIGHT - BOTTOM + 14, f"{value:.3g}", "middle") for value in ticks_x]
    parts += [_text(LEFT - 6, down(value) + 4, f"{value:.3g}", "end") for value in ticks_y]
    parts.append(_text(0.5 * (LEFT + WIDTH), HEIGHT - 4, axis_label(labels[0]), "middle"))
    parts.append(_text(4, 14, axis_label(labels[1]), "start"))
    for place, ((name, y), color) in enumerate(zip(shown.items(), (GREY, BLUE), strict=False)):
        known = np.isfinite(x) & np.isfinite(y)
        points = " ".join(f"{across(a):.1f},{down(b):.1f}" for a, b in zip(x[known], y[known], strict=True))
        width = 2.5 if place == 0 else 1.2
        parts.append(f"<polyline points='{points}' fill='none' stroke='{color}' stroke-width='{width}'/>")
        parts.append(_text(WIDTH - 10 - 110 * place, 14, name, "end", color))
    title = html.escape(f"{axis_label(labels[1])} over {axis_label(labels[0])}: {', '.join(shown)}")
    return (
        f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' width='{WIDTH}' style='max-width:100%' role='img' aria-label='{title}' "
        f"font-family='sans-serif' font-size='11'>{''.join(parts)}</svg>"
    )


def _limits(some: Sequence[Array]) -> tuple[float, float]:
    """Smallest and largest finite value, made different if they are equal."""
    known = np.concatenate([values[np.isfinite(values)] for values in some])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _text(x: float, y: float, words: str, anchor: str, color: str = "currentColor") -> str:
    return f"<text x='{x:.0f}' y='{y:.0f}' text-anchor='{anchor}' fill='{color}'>{html.escape(words)}</text>"
