"""The status banner of the live page: state, reason, remedy and current values; and the table of events."""

import html
import re
import time
from collections.abc import Iterable
from math import hypot
from pathlib import Path

import numpy as np

from piezod.control import CAUSE_TEXT, Cause, State
from piezod.report.live.feed import Event, Feed
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

STALE = "STALE"
_COLOURS = {
    State.DISARMED.name: GREY,
    State.ARMING.name: BLUE,
    State.RUNNING.name: GREEN,
    State.HOLD.name: ORANGE,
    State.RAMP_DOWN.name: ORANGE,
    State.FAULT.name: RED,
    STALE: RED,
}
_SYMBOLS = {
    State.FAULT.name: "\N{MULTIPLICATION SIGN}",
    STALE: "?",
    State.RUNNING.name: "\N{BLACK RIGHT-POINTING TRIANGLE}",
}
_NUMBER_AND_UNIT = re.compile(r"(?<=\d) (?=[%\N{DEGREE SIGN}A-Za-z])")
_LAST_EVENTS = 8
FEW_MISSED = 1e-4  # share of missed ticks that a machine may have: `piezod latency` calls such a rate held
INK_CSS = """
:host { color: #1b1d20; }
@media screen and (prefers-color-scheme: dark) { :host { color: #e3e5e8; } }
"""

BANNER_CSS = """
:host .bk-clearfix { width: 100%; }
:host { font: 14px/1.35 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
.about { color: #555; margin: 0 0 8px; }
.banner { display: flex; gap: 14px; align-items: center; }
.banner .symbol { flex: none; width: 46px; height: 46px; border-radius: 50%; color: #fff; font-size: 26px;
  line-height: 46px; text-align: center; }
.banner b { font-size: 21px; } .banner .remedy { font-weight: 600; }
.banner p { margin: 0; }
.values { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 8px; margin-top: 10px; }
.values div { background: #f5f6f7; border-radius: 6px; padding: 5px 10px; }
.values span { display: block; color: #555; font-size: 12px; }
.values .warn { background: #fff1d0; box-shadow: inset 4px 0 #e69f00; }
.values .bad { background: #fde3d6; box-shadow: inset 4px 0 #b84e00; } .values .bad b { color: #8f3c00; }
.values b { font-size: 16px; font-variant-numeric: tabular-nums; }
@media screen and (prefers-color-scheme: dark) {
  .about, .values span { color: #a8aeb6; } .values div { background: #1f2227; }
  .values .warn { background: #3a2f14; } .values .bad { background: #3d2215; } .values .bad b { color: #ffb38a; }
}
"""

EVENTS_CSS = """
table { border-collapse: collapse; width: 100%; font: 13px/1.35 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
td { padding: 4px 12px 4px 0; border-bottom: 1px solid #d9d9d9; vertical-align: top; }
td:first-child { font-variant-numeric: tabular-nums; white-space: nowrap; color: #555; }
td:nth-child(2) { font-weight: 600; white-space: nowrap; } td:last-child { width: 99%; }
@media (max-width: 600px) {
  td { display: inline-block; border: 0; padding: 1px 10px 1px 0; } td:last-child { display: block; width: auto; }
  tr { display: block; border-bottom: 1px solid #d9d9d9; padding: 4px 0; }
}
@media screen and (prefers-color-scheme: dark) {
  td, tr { border-color: #3b3f45; } td:first-child { color: #a8aeb6; }
}
"""


def state_and_remedy(feed: Feed) -> tuple[str, str, str]:
    """State, reason and remedy as text. The remedy is empty if nothing needs to be done.

    Parameters
    ----------
    feed
        Curves, events and status of the bench as of the last update.
    """
    if feed.last is None:
        return STALE, *_why_stale(feed)
    state = State(feed.last["state"])
    reason, _, remedy = CAUSE_TEXT[Cause(feed.last["cause"])].partition("; ")
    if feed.stale:
        silent, check = _why_stale(feed)
        return STALE, f"{silent}; then {state.name}, {reason}", check
    if state is State.FAULT:
        remedy = f"{remedy}; then piezod reset" if remedy else "find the cause, then piezod reset"
    elif state is State.DISARMED and not remedy:
        remedy = "to start: piezod arm"
    return state.name, reason, remedy


def _why_stale(feed: Feed) -> tuple[str, str]:
    """Reason and remedy when no values come from the device, from the status of the daemon."""
    status = feed.status
    if status is None:
        remedy = "start it: piezod run CONFIG, or systemctl start piezod"
        return feed.problem or "the daemon has not answered yet", remedy
    if not status["connected"]:
        return status["problem"] or "the daemon is starting", "the daemon retries automatically"
    return "the daemon answers, but its control process writes no ticks", "see its log: journalctl -u piezod"


def banner_html(feed: Feed) -> str:
    """HTML of the banner and the current values, with escaped text.

    Parameters
    ----------
    feed
        Curves, events and status of the bench as of the last update.
    """
    state, reason, remedy = state_and_remedy(feed)
    text = f"<b>{state.replace('_', ' ')}</b><p>{html.escape(reason)}</p>"
    if remedy:
        text += f"<p class='remedy'>{html.escape(remedy)}</p>"
    symbol = f"<div class='symbol' style='background:{_COLOURS[state]}'>{_SYMBOLS.get(state, '')}</div>"
    values = "".join(
        f"<div class='value {kind}'><span>{name}</span><b>{_unbroken(html.escape(value))}</b></div>"
        for name, value, kind in (*_values(feed), *_judged(feed))
    )
    return f"{about_html(feed)}<div class='banner'>{symbol}<div>{text}</div></div><div class='values'>{values}</div>"


def about_html(feed: Feed) -> str:
    """HTML of a line with model, rate, version and time since the start of the daemon, with escaped text.

    Parameters
    ----------
    feed
        Status of the bench as of the last update.
    """
    parts = [f"{feed.bench.rate_Hz:g} Hz"]
    if (status := feed.status) is not None:
        model = status.get("model")
        parts.insert(0, f"model {Path(model).name}" if model else "without a model")
        parts += [f"piezod {status['version']}", f"up {_lasting(status['up_s'])}"]
    return f"<p class='about'>{' · '.join(_unbroken(html.escape(part)) for part in parts)}</p>"


def _unbroken(text: str) -> str:
    """The text with each number and its unit on one line."""
    return _NUMBER_AND_UNIT.sub("\N{NO-BREAK SPACE}", text)


def _lasting(time_s: float) -> str:
    for name, unit_s in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if time_s >= 2.0 * unit_s:
            return f"{int(time_s // unit_s)} {name}"
    return f"{int(time_s)} s"


def _values(feed: Feed) -> Iterable[tuple[str, str, str]]:
    """Name, value and class of the present values."""
    row = None if feed.stale else feed.last

    def text(column: str, unit: str) -> str:
        if row is None or not np.isfinite(row[column]):
            return "-"
        return f"{round(float(row[column]), 2) + 0.0:.2f} {unit}"

    stale = "bad" if feed.stale else ""
    yield "force", text("force_N", "N"), stale
    yield "reference", text("reference_N", "N"), stale
    yield "voltage", text("voltage_V", "V"), stale
    if feed.bench.has_role("voltage_readback"):
        yield "read back", text("readback_V", "V"), stale
    if feed.bench.has_role("temperature"):
        yield "temperature", text("temperature_C", "\N{DEGREE SIGN}C"), stale
    status = feed.status
    if status is None:
        return
    learning = status.get("learning")
    if learning and learning["rms_N"] is not None:
        yield (
            f"error, pass {learning['passes']}",
            f"{learning['first_N']:.2f} \N{RIGHTWARDS ARROW} {learning['rms_N']:.2f} N",
            "",
        )


def _judged(feed: Feed) -> Iterable[tuple[str, str, str]]:
    """Name, value and class of the counts that can be bad: empty, `warn` or `bad`."""
    status = feed.status
    if status is None:
        return
    missed, due = status["missed"], status["missed"] + status["ticks"]
    share = missed / due if due else 0.0
    text = f"{_short(missed)} of {_short(due)}" + (f", {100.0 * share:.2g} %" if missed else "")
    yield "ticks missed", text, _kind(share > 0.0, share > FEW_MISSED)
    failed = status["failed_exchanges"]
    yield "exchanges failed", str(failed), _kind(failed > 0, failed > FEW_MISSED * due)
    if recorder := status.get("recorder"):
        degraded = bool(recorder["degraded"])
        yield "ticks recorded", "DEGRADED" if degraded else _short(recorder["rows"]), _kind(degraded, degraded)
    drift = status.get("drift")
    if drift and drift["rms_N"] is not None:
        whole_N = hypot(drift["rms_N"], drift["offset_N"])
        drifted = bool(drift["drifted"])
        outside = bool(drift.get("outside"))
        state = "DRIFTED" if drifted else "not compared" if outside else "holds"
        yield "model", f"{state}, {whole_N:.2f} N rms", _kind(outside, drifted)


def _kind(warn: bool, bad: bool) -> str:
    return "bad" if bad else "warn" if warn else ""


def _short(count: int) -> str:
    for factor, prefix in ((1_000_000, "M"), (1000, "k")):
        if count >= 10 * factor:
            return f"{count / factor:.1f} {prefix}"
    return str(count)


def events_html(events: Iterable[Event]) -> str:
    """HTML table of the last events, the newest first, with escaped text.

    Parameters
    ----------
    events
        Events, the oldest first.
    """
    newest = list(events)[: -_LAST_EVENTS - 1 : -1]
    rows = "".join(
        f"<tr><td>{time.strftime('%H:%M:%S', time.localtime(event.wall_s))}.{int(event.wall_s % 1 * 1000):03d}</td>"
        f"<td>{html.escape(event.name.replace('_', ' '))}</td><td>{html.escape(event.text)}</td></tr>"
        for event in newest
    )
    return f"<table><tbody>{rows}</tbody></table>" if rows else "<p>none yet</p>"
