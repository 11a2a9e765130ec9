"""One viewer of the live page: a Bokeh document that shows the new points of the shared feed."""

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
from piezod.report.live.figures import Figures, fit_range
from piezod.report.live.status_banner import BANNER_CSS, EVENTS_CSS, INK_CSS, banner_html, events_html, state_and_remedy

UPDATE_EVERY_ms = 250
HISTOGRAMS_EVERY_s = 1.0
RETRY_AFTER_s = 1.0  # after a wrong token
STANDING = "zoomed: the curves stand still; the reset tool shows the present"
ACTIONS = ("arm", "disarm", "stop", "reset")

Command = Callable[[str], Awaitable[str]]


class Viewer:
    """Figures, banner and events of one browser."""

    def __init__(self, document: Document, feed: Feed) -> None:
        self._document, self._feed = document, feed
        self._figures = Figures(feed.bench)
        self._banner = Div(name="banner", sizing_mode="stretch_width", stylesheets=[INK_CSS, BANNER_CSS])
        self._events = Div(name="events", sizing_mode="stretch_width", stylesheets=[INK_CSS, EVENTS_CSS])
        self._shown_over_time = self._shown_loop = 0
        self._shown_events = -1
        self._histograms_s = float("-inf")
        self._zoomed = False
        self._figures.on_zoom(self._zoom)
        with document.models.freeze():  # without it each addition visits all models
            for name, plot in self._figures.roots().items():
                plot.name = name
                document.add_root(plot)
            document.add_root(self._banner)
            document.add_root(self._events)
            self.update()
        document.add_periodic_callback(self.update, UPDATE_EVERY_ms)

    def update(self) -> None:
        """Show the new points. Bokeh calls it again only after the browser has received the last update."""
        feed = self._feed
        self._document.title = f"{state_and_remedy(feed)[0].replace('_', ' ')}: {feed.bench.name}"
        self._banner.text = banner_html(feed)
        if feed.event_count != self._shown_events:
            self._shown_events = feed.event_count
            self._events.text = events_html(feed.events)
        if not self._zoomed:
            self._update_figures()

    def _zoom(self, *, zoomed: bool) -> None:
        """Keep the curves as they are while a viewer has zoomed in."""
        self._zoomed = zoomed
        self._figures.force_title.text = STANDING if zoomed else ""

    def _update_figures(self) -> None:
        feed, figures = self._feed, self._figures
        over_time = feed.curves.over_time
        if over_time.total > self._shown_over_time:
            new = over_time.since(self._shown_over_time)
            self._shown_over_time = over_time.total
            figures.over_time.stream({**new}, rollover=over_time.capacity)
            points = over_time.since(0)
            fit_range(figures.force_range, points["force_N"], points["reference_N"])
            fit_range(figures.error_range, points["error_N"])
        now_ms = 1000.0 * (time.time() + time.localtime().tm_gmtoff)
        figures.window.update(start=now_ms - 1000.0 * WINDOW_s, end=now_ms)
        loop = feed.curves.loop
        if loop.total > self._shown_loop:
            new = loop.since(self._shown_loop)
            self._shown_loop = loop.total
            figures.loop.stream({**new}, rollover=loop.capacity)
            fit_range(figures.loop_range, loop.since(0)["force_N"])
            figures.now.data = {name: values[-1:] for name, values in new.items()}
        if time.monotonic() - self._histograms_s >= HISTOGRAMS_EVERY_s:
            self._histograms_s = time.monotonic()
            self._update_histograms()

    def _update_histograms(self) -> None:
        for name, durations in (("lateness", self._feed.lateness), ("exchange", self._feed.exchange)):
            self._figures.durations[name].data = bars(durations.counts())
            self._figures.summaries[name].text = durations.summary()


def add_command_buttons(document: Document, token: str, command: Command) -> None:
    """Add a field for the token and buttons that send commands to the daemon.

    Parameters
    ----------
    token
        Token that the viewer must type.
    command
        Sends a command and returns its result as text; never raises.
    """
    typed = PasswordInput(placeholder="token", width=180)
    result = Div(text="Commands need the token.", sizing_mode="stretch_width", stylesheets=[INK_CSS])
    wait_until_s = 0.0

    def press(name: str) -> None:
        nonlocal wait_until_s
        if time.monotonic() < wait_until_s or not hmac.compare_digest(typed.value.encode(), token.encode()):
            wait_until_s = time.monotonic() + RETRY_AFTER_s
            result.text = "refused: wrong token"
            return

        async def send() -> None:
            result.text = html.escape(await command(name))

        document.add_next_tick_callback(cast("Callable[[], None]", send))  # Bokeh awaits the coroutine

    buttons = []
    for name in ACTIONS:
        button = Button(label=name, width=80, button_type="danger" if name == "stop" else "default")
        button.on_click(lambda name=name: press(name))
        buttons.append(button)
    document.add_root(row(typed, *buttons, name="buttons", sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}))
    result.name = "result"
    document.add_root(result)
