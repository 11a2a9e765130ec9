"""The demo's page tells what was hidden, what was found, and what each compensation leaves."""

from piezod.report.tracking.hidden import HiddenVerdict, hidden_html
from piezod.report.tracking.tracking_errors import TrackingFigures


def figures(rms_N):
    return TrackingFigures(1000, 200.0, rms_N, 0.5 * rms_N, 3.0 * rms_N, 1.5 * rms_N, None)


def test_the_page_tells_the_whole_story_of_the_hidden_effects():
    errors = {"gain": figures(9.83), "inverse": figures(4.51), "extended": figures(0.17)}
    hidden = HiddenVerdict("explained: creep, 1.47 % & a lag", errors, 0.1, {"creep of the stack": 0.99, "lag": 0.98})
    page = hidden_html(hidden)
    assert "Creep of the stack, a lag of the amplifier and a delay were hidden" in page
    assert "explained: creep, 1.47 % &amp; a lag" in page
    assert "creep of the stack 99 % (high), lag 98 % (high)" in page
    for words in (
        "plain gain",
        "hysteresis inverse",
        "extended inverse",
        "noise of the reading",
        "9.83",
        "4.51",
        "0.17",
    ):
        assert words in page
    assert hidden.as_dict()["confidences"]["lag"] == 0.98
