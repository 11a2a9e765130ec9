"""What the lamp says: the state, why it is so, what to do about it; and the numbers beside it."""

import html
import time
from collections.abc import Iterable

import numpy as np

from piezod.control import CAUSE_TEXT, Cause, State
from piezod.report.live.feed import Event, Feed
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

NO_TICKS = "NO TICKS"
_COLOURS = {
    State.DISARMED.name: GREY,
    State.ARMING.name: BLUE,
    State.RUNNING.name: GREEN,
    State.HOLD.name: ORANGE,
    State.RAMP_DOWN.name: ORANGE,
    State.FAULT.name: RED,
    NO_TICKS: RED,
}
_SIGNS = {
    State.FAULT.name: "\N{MULTIPLICATION SIGN}",
    NO_TICKS: "?",
    State.RUNNING.name: "\N{BLACK RIGHT-POINTING TRIANGLE}",
}
_LAST_EVENTS = 8

LAMP_STYLE = """
:host .bk-clearfix { width: 100%; }
:host { font: 14px/1.35 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
.lamp { display: flex; gap: 14px; align-items: center; }
.lamp .light { flex: none; width: 46px; height: 46px; border-radius: 50%; color: #fff; font-size: 26px;
  line-height: 46px; text-align: center; }
.lamp b { font-size: 21px; } .lamp .remedy { font-weight: 600; }
.lamp p { margin: 0; }
.values { display: grid; grid-template-columns: repeat(auto-fit, minmax(132px, 1fr)); gap: 8px; margin-top: 10px; }
.values div { background: #f5f6f7; border-radius: 6px; padding: 5px 10px; }
.values span { display: block; color: #555; font-size: 12px; }
.values b { font-size: 16px; font-variant-numeric: tabular-nums; white-space: nowrap; }
"""

EVENTS_STYLE = """
table { border-collapse: collapse; width: 100%; font: 13px/1.35 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
td { padding: 4px 12px 4px 0; border-bottom: 1px solid #d9d9d9; vertical-align: top; }
td:first-child { font-variant-numeric: tabular-nums; white-space: nowrap; color: #555; }
td:nth-child(2) { font-weight: 600; white-space: nowrap; } td:last-child { width: 99%; }
@media (max-width: 600px) {
  td { display: inline-block; border: 0; padding: 1px 10px 1px 0; } td:last-child { display: block; width: auto; }
  tr { display: block; border-bottom: 1px solid #d9d9d9; padding: 4px 0; }
}
"""


def state_words(feed: Feed) -> tuple[str, str, str]:
    """State, reason and remedy; the remedy is empty where nothing need be done."""
    if feed.last is None or feed.quiet:
        return NO_TICKS, *_silence(feed)
    state = State(feed.last["state"])
    reason, _, remedy = CAUSE_TEXT[Cause(feed.last["cause"])].partition("; ")
    if state is State.FAULT:
        remedy = f"{remedy}; then piezod reset" if remedy else "find the cause, then piezod reset"
    elif state is State.DISARMED and not remedy:
        remedy = "piezod arm drives it"
    return state.name, reason, remedy


def _silence(feed: Feed) -> tuple[str, str]:
    """Why no tick comes, as far as the daemon says."""
    status = feed.status
    if status is None:
        return (
            feed.problem or "the daemon has not answered yet",
            "start it: piezod run CONFIG, or systemctl start piezod",
        )
    if not status["connected"]:
        return status["problem"] or "the daemon is starting", "it tries again by itself"
    return "the daemon answers, but its control process writes no ticks", "see its log: journalctl -u piezod"


def lamp_html(feed: Feed) -> str:
    """The lamp and the numbers, every word escaped."""
    state, reason, remedy = state_words(feed)
    sign = _SIGNS.get(state, "")
    said = f"<p>{html.escape(reason)}</p>"
    if remedy:
        said += f"<p class='remedy'>{html.escape(remedy)}</p>"
    light = f"<div class='light' style='background:{_COLOURS[state]}'>{sign}</div>"
    lamp = f"<div class='lamp'>{light}<div><b>{state.replace('_', ' ')}</b>{said}</div></div>"
    values = "".join(f"<div><span>{name}</span><b>{html.escape(value)}</b></div>" for name, value in _values(feed))
    return f"{lamp}<div class='values'>{values}</div>"


def _values(feed: Feed) -> Iterable[tuple[str, str]]:
    row, known = feed.last, not (feed.last is None or feed.quiet)

    def said(name: str, unit: str) -> str:
        return (
            f"{round(float(row[name]), 2) + 0.0:.2f} {unit}"
            if known and row is not None and np.isfinite(row[name])
            else "-"
        )

    yield "force", said("force_N", "N")
    yield "reference", said("reference_N", "N")
    yield "voltage", said("voltage_V", "V")
    if feed.bench.has_role("voltage_readback"):
        yield "read back", said("readback_V", "V")
    if feed.bench.has_role("temperature"):
        yield "temperature", said("temperature_C", "\N{DEGREE SIGN}C")
    status = feed.status
    if status is None:
        return
    yield "ticks missed", f"{_short(status['missed'])} of {_short(status['ticks'])}"
    yield "exchanges failed", str(status["failed_exchanges"])
    if recorder := status.get("recorder"):
        yield "ticks recorded", "DEGRADED" if recorder["degraded"] else _short(recorder["rows"])


def _short(count: int) -> str:
    for factor, sign in ((1_000_000, "M"), (1000, "k")):
        if count >= 10 * factor:
            return f"{count / factor:.1f} {sign}"
    return str(count)


def events_html(events: Iterable[Event]) -> str:
    """The last events, the newest first, every word escaped."""
    newest = list(events)[: -_LAST_EVENTS - 1 : -1]
    rows = "".join(
        f"<tr><td>{time.strftime('%H:%M:%S', time.localtime(one.wall_s))}.{int(one.wall_s % 1 * 1000):03d}</td>"
        f"<td>{html.escape(one.name.replace('_', ' '))}</td><td>{html.escape(one.text)}</td></tr>"
        for one in newest
    )
    return f"<table><tbody>{rows}</tbody></table>" if rows else "<p>none yet</p>"
