"""The demo's second part: a bench with hidden effects, their diagnosis, and the error of each compensation."""

import html
from dataclasses import dataclass, field
from typing import Any

from piezod.diagnose.verdict.words import confidence_words
from piezod.recording import Recording
from piezod.report.page import table_html
from piezod.report.tracking.tracking_errors import LABELS, FigureKey, TrackingFigures, tracking_figures

MOST_ERROR = 0.5  # rms error with the extended over that with the static model at which the demo passes
ERRORS_HEADER = ("compensation", "rms error [N]", "[%]", "max error [N]", "[%]")  # of `TrackingFigures.cells`


@dataclass(frozen=True)
class HiddenVerdict:
    """Result on the bench with hidden effects: the diagnosis, and the errors with and without its effects.

    Parameters
    ----------
    diagnosis
        Verdict sentence of the diagnosis.
    figures
        Errors by compensation: gain, inverse, extended.
    noise_N
        Noise of the reading, estimated by the diagnosis [N].
    confidences
        Of each effect that was found, by its title.
    """

    diagnosis: str
    figures: dict[str, TrackingFigures]
    noise_N: float
    confidences: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether the extended model reduces the rms error at least to half."""
        return self.figures["extended"].rms_error_N <= MOST_ERROR * self.figures["inverse"].rms_error_N

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        static, extended = self.figures["inverse"], self.figures["extended"]
        return (
            f"hidden effects: rms error {static.rms_error_percent:.2f} % -> {extended.rms_error_percent:.2f} % "
            f"of range ({'at most' if self.passed else 'NOT below'} {MOST_ERROR:.0%} of it); "
            f"the noise of the reading is {100.0 * self.noise_N / extended.range_N:.2f} %"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        figures = [{"compensation": name, **errors.as_dict()} for name, errors in self.figures.items()]
        return {
            "diagnosis": self.diagnosis,
            "confidences": self.confidences,
            "noise_N": self.noise_N,
            "figures": figures,
            "virtual_time": True,
        }


def evaluate_hidden(
    recordings: dict[FigureKey, Recording], diagnosis: str, noise_N: float, confidences: dict[str, float]
) -> HiddenVerdict:
    """Compute the figures on the bench with hidden effects.

    Parameters
    ----------
    recordings
        By (reference, compensation).
    diagnosis
        Verdict sentence of the diagnosis.
    noise_N
        Noise of the reading, estimated by the diagnosis [N].
    confidences
        Of each effect that was found, by its title.
    """
    figures = {name: tracking_figures(recording, loop=False) for (_, name), recording in recordings.items()}
    return HiddenVerdict(diagnosis, figures, noise_N, confidences)


def print_hidden(hidden: HiddenVerdict) -> None:
    """Print diagnosis, errors of each compensation, noise and verdict of `hidden`, the bench with hidden effects."""
    print("a bench with hidden creep, lag and delay (emulated in virtual time, as fast as this machine allows):")
    print(f"  diagnosis: {hidden.diagnosis}")
    for name, rms_N, rms, max_N, largest in (ERRORS_HEADER, *_rows(hidden)):
        print(f"  {name:<20} {rms_N:>13} {rms:>6} {max_N:>14} {largest:>6}")
    print(hidden.sentence)


def hidden_html(hidden: HiddenVerdict) -> str:
    """Hidden effects, found effects, and the error of each compensation.

    Parameters
    ----------
    hidden
        Result on the bench with hidden effects.
    """
    sure = ", ".join(f"{title} {confidence_words(confidence)}" for title, confidence in hidden.confidences.items())
    return (
        "<h2>A bench with something wrong in it</h2>"
        "<p>Creep of the stack, a lag of the amplifier and a delay were hidden in the emulated bench. "
        "The diagnosis got the model without them and one recording.</p>"
        f"<p><strong>{html.escape(hidden.diagnosis)}</strong></p><p>Confidence: {html.escape(sure)}.</p>"
        + table_html(ERRORS_HEADER, _rows(hidden))
    )


def _rows(hidden: HiddenVerdict) -> list[list[str]]:
    """Errors of each compensation, and the noise in their place."""
    share = 100.0 * hidden.noise_N / hidden.figures["extended"].range_N
    rows = [[LABELS[name], *errors.cells] for name, errors in hidden.figures.items()]
    return [*rows, ["noise of the reading", f"{hidden.noise_N:.2f}", f"{share:.2f}", "-", "-"]]
