"""Lineage of the model that a diagnosis writes: parent, date, recordings, status of each effect and of the base."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from piezod.diagnose.findings import Finding, Findings
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.words import Wording, base_words, effect_words, law_words
from piezod.effects import EFFECTS
from piezod.estimation.recordings.layout import entry_of
from piezod.estimation.recordings.sources import Source
from piezod.model import Model
from piezod.model.parameters import BASE, ModelChange

UNNAMED_LAW = "unnamed_law"  # name of a law without a physical name among the changes of a model


def with_lineage(diagnosis: Diagnosis, given: Model, parent: str, recordings: Sequence[Source]) -> Diagnosis:
    """Diagnosis whose written model states its lineage; a given model that stays keeps its own.

    Parameters
    ----------
    parent
        SHA-256 of the file of the given model.
    """
    if diagnosis.model is given:
        return diagnosis
    plain = diagnosis.without_law
    known = diagnosis.model.provenance
    hashes = {entry.sha256 for entry in (*known.recordings, *known.diagnosed)}
    added = [
        entry_of(source.recording, source.sha256, source.text) for source in recordings if source.sha256 not in hashes
    ]
    provenance = known.model_copy(
        update={
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "parent": parent,
            "diagnosed": (*known.diagnosed, *added),
            "changes": changes_of(diagnosis.findings, Wording(given.input.unit, given.output.unit)),
        }
    )
    return replace(
        diagnosis,
        model=diagnosis.model.model_copy(update={"provenance": provenance}),
        without_law=None if plain is None else with_lineage(plain, given, parent, recordings),
    )


def changes_of(findings: Findings, wording: Wording) -> tuple[ModelChange, ...]:
    """Status of every effect and of the base in the findings, with the reason in words."""
    base = findings.base
    changes = [
        ModelChange(name=finding.name, status=finding.status, words=_reason(finding, findings.unit, wording))
        for finding in findings.effects
    ]
    changes += [
        ModelChange(
            name=effect.name,
            status="kept" if effect.seen else "not seen",
            words=f"{EFFECTS[effect.name].title} {'as before' if effect.seen else 'not determined, as before'}",
        )
        for effect in findings.kept
    ]
    words = base_words(base) if base.changed else "gain and loops of the stack as before"
    changes.append(ModelChange(name=BASE, status="changed" if base.changed else "kept", words=words))
    if findings.law is not None:
        changes.append(ModelChange(name=UNNAMED_LAW, status="new", words=law_words(findings.law)))
    return tuple(changes)


def _reason(finding: Finding, unit: str, wording: Wording) -> str:
    """Clause about an effect, with its errors on left-out blocks."""
    words = effect_words(finding, wording)
    if finding.before == finding.after:
        return words
    return f"{words}; error on left-out blocks {finding.before:.3g} -> {finding.after:.3g} {unit}"
