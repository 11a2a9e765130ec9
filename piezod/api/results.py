"""Results of `piezod.identify` and `piezod.diagnose`, which show themselves in a notebook."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezod.api.model import Model
from piezod.api.notebook import curves_svg, result_html
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.words import Wording, label_of, value_words
from piezod.effects import EFFECTS
from piezod.identify.identification import Identification
from piezod.identify.simulation import simulate_recording
from piezod.recording import Recording
from piezod.report.diagnosis.page import write_diagnosis_page
from piezod.report.identification import (
    figure_rows,
    identification_as_dict,
    write_identification_page,
)


@dataclass(frozen=True)
class Identified:
    """A model and how well it fits.

    Parameters
    ----------
    identification
        All that is known of it.
    recordings
        What it was identified on, as it was used.
    """

    identification: Identification
    recordings: tuple[Recording, ...]

    @property
    def model(self) -> Model:
        """The model."""
        return Model.of(self.identification.model)

    @property
    def verdict(self) -> str:
        """In a sentence, how good the model is."""
        return self.identification.verdict

    @property
    def useful(self) -> bool:
        """Whether the model explains more than it leaves."""
        return self.identification.useful

    @property
    def error(self) -> float:
        """Rms error on held-out data [output unit]."""
        return self.identification.chosen.rms_held_out

    @property
    def notes(self) -> list[str]:
        """What was noticed in the recordings."""
        return self.identification.notes

    def as_dict(self) -> dict[str, Any]:
        """The result as `piezod identify --json` prints it."""
        return identification_as_dict(self.identification)

    def write_page(self, path: str | Path) -> None:
        """Write the page that `piezod identify --report` writes."""
        write_identification_page(Path(path), self.identification, self.recordings)

    def __str__(self) -> str:
        """The verdict."""
        return self.verdict

    def _repr_html_(self) -> str:
        model, first = self.model, self.recordings[0]
        rows = [("", "fit", "held out"), *figure_rows(self.identification)]
        simulated = simulate_recording(model, first, 1.0).recording.channel(model.output.channel)
        measured = first.channel(model.output.channel)
        picture = curves_svg(
            first.channel(model.input.channel),
            {"measured": measured, "model": simulated},
            (model.input.channel, model.output.channel),
        )
        return result_html(self.verdict, rows, self.notes, picture)


@dataclass(frozen=True)
class Diagnosed:
    """What a model lacks.

    Parameters
    ----------
    diagnosis
        All that is known of it.
    """

    diagnosis: Diagnosis

    @property
    def model(self) -> Model:
        """The model with the effects that were found; the given one where none was."""
        return Model.of(self.diagnosis.model)

    @property
    def verdict(self) -> str:
        """One of `matches`, `explained`, `partly_explained`, `unexplained`, `not_testable`."""
        return self.diagnosis.findings.verdict

    @property
    def words(self) -> str:
        """What was found, in a sentence."""
        return self.diagnosis.findings.words

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that are new, have changed or are gone."""
        return tuple(one.name for one in self.diagnosis.findings.effects)

    @property
    def kept(self) -> tuple[str, ...]:
        """Names of the effects of the given model that have not changed, as far as the recordings tell."""
        return tuple(one.name for one in self.diagnosis.findings.kept)

    @property
    def findings(self) -> dict[str, Any]:
        """The content of `findings.json`."""
        return self.diagnosis.findings.as_dict()

    def write_page(self, path: str | Path) -> None:
        """Write the page that `piezod diagnose` writes."""
        write_diagnosis_page(Path(path), self.diagnosis)

    def __str__(self) -> str:
        """Verdict and words."""
        return f"{self.verdict.replace('_', ' ')}: {self.words}"

    def _repr_html_(self) -> str:
        findings, model = self.diagnosis.findings, self.diagnosis.model
        wording = Wording(model.input.unit, model.output.unit)
        rows = [("effect", "status", "confidence", "parameters", "held-out error")]
        for one in findings.effects:
            values = [
                f"{label_of(name, value.unit)} {value_words(value, name, one.name, wording)[0]}"
                for name, value in one.parameters.items()
            ]
            errors = f"{one.before:.3g} to {one.after:.3g} {findings.unit}"
            rows.append((one.title, one.status, f"{100 * one.confidence:.0f} %", ", ".join(values), errors))
        series, last = self.diagnosis.series[-1], len(self.diagnosis.series) - 1
        residuals = {
            "given model": series.reading_N - self.diagnosis.base[last],
            "with the effects": series.reading_N - self.diagnosis.extended[last],
        }
        picture = curves_svg(series.time_s, residuals, ("time_s", f"residual_{model.output.unit}"))
        for kept in findings.kept:
            values = [
                f"{label_of(name, value.unit)} {value_words(value, name, kept.name, wording)[0]}"
                for name, value in kept.parameters.items()
            ]
            rows.append((EFFECTS[kept.name].title, "kept" if kept.seen else "not seen", "", ", ".join(values), ""))
        return result_html(str(self), rows if len(rows) > 1 else [], list(findings.notes), picture)
