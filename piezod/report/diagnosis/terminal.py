"""Text of a diagnosis for a terminal, and the next step after it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from piezod.diagnose.findings import Finding
from piezod.diagnose.judgement import Diagnosis
from piezod.diagnose.verdict.words import Wording, confidence_words, label_of, law_words, place_words, value_words
from piezod.model import without_inverse
from piezod.report.diagnosis.wording import SCOPES
from piezod.report.next_step import NextStep
from piezod.report.next_step.of_models import after_diagnose


def findings_text(diagnosis: Diagnosis, folder: Path) -> str:
    """Verdict, effects with their rivals, notes, and the names of the written files."""
    findings = diagnosis.findings
    wording = Wording(diagnosis.model.input.unit, diagnosis.model.output.unit)
    lines = [f"{findings.verdict.replace('_', ' ')}: {findings.words}"]
    for finding in findings.effects:
        lines += _effect_lines(finding, wording)
    for old in findings.kept:
        values = ", ".join(
            f"{label_of(name, value.unit)} {value_words(value, name, old.name, wording)[0]}"
            for name, value in old.parameters.items()
        )
        seen = "kept" if old.seen else "not seen: these recordings could not tell"
        lines.append(f"  {old.name} ({seen}): {values}")
    if (law := findings.law) is not None:
        scope = SCOPES["already" if law.already else "since"]
        change = f"{law.before:.4g} -> {law.after:.4g} {wording.output}"
        lines.append(f"  {law_words(law)} (p-value {law.p:.1g}, {scope})")
        lines.append(f"    held-out error {change}; a description and no cause")
    for held_out in findings.held_out:
        change = f"{held_out.before:.4g} -> {held_out.after:.4g} {findings.unit}"
        lines.append(f"  {held_out.path}, held out: {change}")
    if findings.not_testable:
        lines.append(f"not testable with these recordings: {', '.join(findings.not_testable)}")
    lines += [f"note: {note}" for note in findings.notes]
    files = (folder / name for name in ("findings.json", "model.yaml", "report.html"))
    return "\n".join([*lines, ", ".join(map(str, files))])


def _effect_lines(finding: Finding, wording: Wording) -> Iterator[str]:
    confidence = f"confidence {confidence_words(finding.confidence)}"
    when = SCOPES[finding.scope] if finding.status == "new" else finding.status
    yield f"  {finding.name} ({confidence}, {when}): {finding.title}"
    for name, value in finding.parameters.items():
        text, interval = value_words(value, name, finding.name, wording)
        line = f"    {label_of(name, value.unit)} {text}" + (f" ({interval})" if interval else "")
        was = finding.was.get(name)
        yield line + ("" if was is None else f", was {value_words(was, name, finding.name, wording)[0]}")
    for place in finding.where:
        yield f"    seen at {place_words(place, wording)}"
    yield f"    held-out error {finding.before:.4g} -> {finding.after:.4g} {wording.output}"
    yield f"    {finding.handling}" + (f": {finding.why}" if finding.why else "")
    for rival in finding.rivals:
        difference = f"predictions differ by {rival.separation:.2g} times the noise"
        yield f"    rival {rival.name}: {difference}; to distinguish them: {rival.separate_by}"


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
