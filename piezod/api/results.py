"""Results of `piezod.identify` and `piezod.diagnose`, with a display for notebooks."""

import os
from dataclasses import dataclass
from typing import cast

from piezod.api.arguments import path_of
from piezod.api.findings_document import FindingsDocument
from piezod.api.model import Model
from piezod.api.notebook import curves_svg, result_html
from piezod.diagnose.findings import Finding, UnchangedEffect
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.words import Wording, confidence_words, label_of, value_words
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
    """Result of `piezod.identify`; `recordings` are the recordings as the identification used them.

    Examples
    --------
    >>> found.error < 0.2  # found = piezod.identify("before.csv"), error [N]
    True
    >>> found.model.name
    'stack'
    """

    identification: Identification
    recordings: tuple[Recording, ...]

    @property
    def model(self) -> Model:
        """The model."""
        return Model.of(self.identification.model)

    @property
    def verdict(self) -> str:
        """Quality of the model in a sentence."""
        return self.identification.verdict

    @property
    def useful(self) -> bool:
        """Whether the model explains more than half of the variance."""
        return self.identification.useful

    @property
    def error(self) -> float:
        """Rms error on held-out data [output unit]."""
        return self.identification.chosen.rms_held_out

    @property
    def notes(self) -> list[str]:
        """Notes on the recordings."""
        return self.identification.notes

    def as_dict(self) -> dict[str, object]:
        """The result as `piezod identify --json` prints it.

        Returns
        -------
        dict
            Numbers, texts and lists of them by name.

        Examples
        --------
        >>> found.as_dict()["schema"]
        'piezod.identification/1'
        """
        return identification_as_dict(self.identification)

    def write_page(self, path: str | os.PathLike[str]) -> None:
        """Write the page that `piezod identify --report` writes.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> found.write_page("identified.html")
        """
        write_identification_page(path_of(path), self.identification, self.recordings)

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
    """Result of `piezod.diagnose`.

    Examples
    --------
    >>> diagnosis.effects  # diagnosis = piezod.diagnose("later.csv", found)
    ('transport_delay',)
    >>> [effect.name for effect in diagnosis.model.effects]
    ['transport_delay']
    """

    diagnosis: Diagnosis

    @property
    def model(self) -> Model:
        """The extended model; without new, changed or absent effects the given model."""
        return Model.of(self.diagnosis.model)

    @property
    def verdict(self) -> str:
        """Either `matches`, `explained`, `partly_explained`, `unexplained` or `not_testable`."""
        return self.diagnosis.findings.verdict

    @property
    def words(self) -> str:
        """The findings in a sentence."""
        return self.diagnosis.findings.words

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that are new, have changed or are gone."""
        return tuple(effect.name for effect in self.diagnosis.findings.effects)

    @property
    def kept(self) -> tuple[str, ...]:
        """Names of the effects of the given model without a detected change."""
        return tuple(effect.name for effect in self.diagnosis.findings.kept)

    @property
    def findings(self) -> FindingsDocument:
        """The content of `findings.json`."""
        return cast("FindingsDocument", self.diagnosis.findings.as_dict())

    def write_page(self, path: str | os.PathLike[str]) -> None:
        """Write the page that `piezod diagnose` writes.

        Raises
        ------
        ConfigurationError
            The file cannot be written.
        UsageError
            The argument is no path.

        Examples
        --------
        >>> diagnosis.write_page("diagnosed.html")
        """
        write_diagnosis_page(path_of(path), self.diagnosis)

    def __str__(self) -> str:
        """Verdict and words."""
        return f"{self.verdict.replace('_', ' ')}: {self.words}"

    def _repr_html_(self) -> str:
        findings, model = self.diagnosis.findings, self.diagnosis.model
        wording = Wording(model.input.unit, model.output.unit)
        rows = [("effect", "status", "confidence", "parameters", "held-out error")]
        for effect in findings.effects:
            errors = f"{effect.before:.3g} to {effect.after:.3g} {findings.unit}"
            confidence = confidence_words(effect.confidence)
            rows.append((effect.title, effect.status, confidence, _values(effect, wording), errors))
        for old in findings.kept:
            status = "kept" if old.seen else "not seen"
            rows.append((EFFECTS[old.name].title, status, "", _values(old, wording), ""))
        series, last = self.diagnosis.series[-1], len(self.diagnosis.series) - 1
        residuals = {
            "given model": series.reading_N - self.diagnosis.base[last],
            "with the effects": series.reading_N - self.diagnosis.extended[last],
        }
        picture = curves_svg(series.time_s, residuals, ("time_s", f"residual_{model.output.unit}"))
        return result_html(str(self), rows if len(rows) > 1 else [], list(findings.notes), picture)


def _values(effect: Finding | UnchangedEffect, wording: Wording) -> str:
    """Parameters of an effect with their values."""
    return ", ".join(
        f"{label_of(name, value.unit)} {value_words(value, name, effect.name, wording)[0]}"
        for name, value in effect.parameters.items()
    )
