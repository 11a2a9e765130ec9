"""Text of a diagnosis for a terminal, and the next step after it."""

from collections.abc import Sequence
from pathlib import Path

from piezod.diagnose.findings import Finding
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.words import Wording, confidence_words, label_of, law_words, place_words, value_words
from piezod.model import without_inverse
from piezod.report.diagnosis.wording import SCOPES
from piezod.report.next_step import NextStep
from piezod.report.next_step.of_models import after_diagnose


def print_findings(diagnosis: Diagnosis, folder: Path) -> None:
    """Print verdict, effects with their rivals, notes, and the names of the written files."""
    findings = diagnosis.findings
    wording = Wording(diagnosis.model.input.unit, diagnosis.model.output.unit)
    print(f"{findings.verdict.replace('_', ' ')}: {findings.words}")
    for finding in findings.effects:
        _print_effect(finding, wording)
    for old in findings.kept:
        values = ", ".join(
            f"{label_of(name, value.unit)} {value_words(value, name, old.name, wording)[0]}"
            for name, value in old.parameters.items()
        )
        print(f"  {old.name} ({'kept' if old.seen else 'not seen: these recordings could not tell'}): {values}")
    if (law := findings.law) is not None:
        scope = SCOPES["already" if law.already else "since"]
        print(f"  {law_words(law)} (p-value {law.p:.1g}, {scope})")
        print(f"    held-out error {law.before:.4g} -> {law.after:.4g} {wording.output}; a description and no cause")
    for held_out in findings.held_out:
        print(f"  {held_out.path}, held out: {held_out.before:.4g} -> {held_out.after:.4g} {findings.unit}")
    if findings.not_testable:
        print(f"not testable with these recordings: {', '.join(findings.not_testable)}")
    for note in findings.notes:
        print(f"note: {note}")
    print(f"{folder / 'findings.json'}, {folder / 'model.yaml'}, {folder / 'report.html'}")


def _print_effect(finding: Finding, wording: Wording) -> None:
    confidence = f"confidence {confidence_words(finding.confidence)}"
    when = SCOPES[finding.scope] if finding.status == "new" else finding.status
    print(f"  {finding.name} ({confidence}, {when}): {finding.title}")
    for name, value in finding.parameters.items():
        text, interval = value_words(value, name, finding.name, wording)
        line = f"    {label_of(name, value.unit)} {text}" + (f" ({interval})" if interval else "")
        was = finding.was.get(name)
        print(line + ("" if was is None else f", was {value_words(was, name, finding.name, wording)[0]}"))
    for place in finding.where:
        print(f"    seen at {place_words(place, wording)}")
    print(f"    held-out error {finding.before:.4g} -> {finding.after:.4g} {wording.output}")
    print(f"    {finding.handling}" + (f": {finding.why}" if finding.why else ""))
    for rival in finding.rivals:
        difference = f"predictions differ by {rival.separation:.2g} times the noise"
        print(f"    rival {rival.name}: {difference}; to distinguish them: {rival.separate_by}")


def next_after(
    diagnosis: Diagnosis, recordings: Sequence[Path], model: Path, folder: Path, bench: Path | None = None
) -> NextStep:
    """Next step after a diagnosis.

    Parameters
    ----------
    recordings, model, folder
        Files of the diagnosis, and the folder of its result.
    bench
        Bench file; None: not named.
    """
    written = diagnosis.model
    return after_diagnose(
        diagnosis.findings,
        recordings,
        model,
        folder,
        refused=without_inverse(written),
        bench=bench,
        drives_a_bench=(written.input.unit, written.output.unit) == ("V", "N"),
    )
