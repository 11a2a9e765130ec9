"""One viewer: a document of its own that takes from the feed what it has not shown yet."""

import hmac
import html
import time
from collections.abc import Awaitable, Callable
from typing import cast

from bokeh.document import Document
from bokeh.layouts import row
from bokeh.models.widgets import Button, Div, PasswordInput

from piezod.report.figures.durations import bars
from piezod.report.live.feed import Feed, WINDOW_s
from piezod.report.live.figures import Figures, show_all
from piezod.report.live.status_banner import EVENTS_STYLE, LAMP_STYLE, events_html, lamp_html, state_words

UPDATE_EVERY_ms = 250
SUMMED_EVERY_s = 1.0
GUESS_AGAIN_AFTER_s = 1.0
ACTIONS = ("arm", "disarm", "stop", "reset")

Command = Callable[[str], Awaitable[str]]


class Viewer:
    """What one browser sees.

    Parameters
    ----------
    document
        Its own.
    feed
        Shared with the other viewers.
    """

    def __init__(self, document: Document, feed: Feed) -> None:
        self._document, self._feed = document, feed
        self._figures = Figures(feed.bench)
        self._lamp = Div(name="lamp", sizing_mode="stretch_width", stylesheets=[LAMP_STYLE])
        self._events = Div(name="events", sizing_mode="stretch_width", stylesheets=[EVENTS_STYLE])
        self._shown_over_time = self._shown_loop = 0
        self._happened = -1
        self._summed_s = float("-inf")
        with document.models.freeze():  # adding them one by one walks through all of them each time
            for name, plot in self._figures.roots().items():
                plot.name = name
                document.add_root(plot)
            document.add_root(self._lamp)
            document.add_root(self._events)
            self.update()
        document.add_periodic_callback(self.update, UPDATE_EVERY_ms)

    def update(self) -> None:
        """Show what is new; called again only when the browser has taken the update before."""
        feed, figures = self._feed, self._figures
        self._document.title = f"{state_words(feed)[0].replace('_', ' ')}: {feed.bench.name}"
        self._lamp.text = lamp_html(feed)
        table = feed.curves.over_time
        if table.total > self._shown_over_time:
            fresh = table.since(self._shown_over_time)
            self._shown_over_time = table.total
            figures.over_time.stream({**fresh}, rollover=table.most)
            kept = table.since(0)
            show_all(figures.force_range, kept["force_N"], kept["reference_N"])
            show_all(figures.error_range, kept["error_N"])
        now_ms = 1000.0 * (time.time() + time.localtime().tm_gmtoff)
        figures.window.update(start=now_ms - 1000.0 * WINDOW_s, end=now_ms)
        loop = feed.curves.loop
        if loop.total > self._shown_loop:
            fresh = loop.since(self._shown_loop)
            self._shown_loop = loop.total
            figures.loop.stream({**fresh}, rollover=loop.most)
            show_all(figures.loop_range, loop.since(0)["force_N"])
            figures.now.data = {name: values[-1:] for name, values in fresh.items()}
        if feed.happened != self._happened:
            self._happened = feed.happened
            self._events.text = events_html(feed.events)
        if time.monotonic() - self._summed_s >= SUMMED_EVERY_s:
            self._summed_s = time.monotonic()
            self._sum_up()

    def _sum_up(self) -> None:
        for name, durations in (("lateness", self._feed.lateness), ("exchange", self._feed.exchange)):
            self._figures.durations[name].data = bars(durations.counts())
            self._figures.words[name].text = durations.words()


def add_desk(document: Document, token: str, command: Command) -> None:
    """Add buttons that command the daemon, for whoever types the token.

    Parameters
    ----------
    document
        Of the viewer.
    token
        What must be typed.
    command
        Sends one command and returns what came of it in words; never raises.
    """
    typed = PasswordInput(placeholder="token", width=180)
    said = Div(text="Commands need the token.", sizing_mode="stretch_width")
    wait_until_s = 0.0

    def press(name: str) -> None:
        nonlocal wait_until_s
        if time.monotonic() < wait_until_s or not hmac.compare_digest(typed.value.encode(), token.encode()):
            wait_until_s = time.monotonic() + GUESS_AGAIN_AFTER_s
            said.text = "refused: not the token"
            return

        async def send() -> None:
            said.text = html.escape(await command(name))

        document.add_next_tick_callback(cast("Callable[[], None]", send))  # Bokeh awaits what it gets

    buttons = []
    for name in ACTIONS:
        button = Button(label=name, width=80, button_type="danger" if name == "stop" else "default")
        button.on_click(lambda name=name: press(name))
        buttons.append(button)
    document.add_root(row(typed, *buttons, name="desk", sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}))
    said.name = "said"
    document.add_root(said)
