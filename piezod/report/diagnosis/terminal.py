"""What a diagnosis found, as text for a terminal."""

from pathlib import Path

from piezod.diagnose.diagnosis import Diagnosis
from piezod.diagnose.findings import Finding
from piezod.diagnose.words import Wording, label_of, place_words, value_words


def print_findings(diagnosis: Diagnosis, folder: Path) -> None:
    """Verdict, effects, rivals and notes as text.

    Parameters
    ----------
    diagnosis
        What was found.
    folder
        Where its files were written.
    """
    findings = diagnosis.findings
    wording = Wording(diagnosis.model.input.unit, diagnosis.model.output.unit)
    print(f"{findings.verdict.replace('_', ' ')}: {findings.words}")
    for one in findings.effects:
        _print_effect(one, wording)
    for held in findings.held_out:
        print(f"  {held.path}, held out: {held.before:.4g} -> {held.after:.4g} {findings.unit}")
    if findings.not_testable:
        print(f"could not have been seen in these recordings: {', '.join(findings.not_testable)}")
    for note in findings.notes:
        print(f"note: {note}")
    print(f"{folder / 'findings.json'}, {folder / 'model.yaml'}, {folder / 'report.html'}")


def _print_effect(one: Finding, wording: Wording) -> None:
    scope = {"already": "already there when the model was identified", "since": "come since", "once": "once"}[one.scope]
    print(f"  {one.name} (confidence {100 * one.confidence:.0f} %, {scope}): {one.title}")
    for name, value in one.parameters.items():
        middle, interval = value_words(value, name, one.name, wording)
        print(f"    {label_of(name, value.unit)} {middle}" + (f" ({interval})" if interval else ""))
    for place in one.where:
        print(f"    seen at {place_words(place, wording)}")
    print(f"    held-out error {one.before:.4g} -> {one.after:.4g} {wording.output}")
    print(f"    {one.handling}" + (f": {one.why}" if one.why else ""))
    for rival in one.rivals:
        print(f"    rival {rival.name}, {rival.separation:.2g} noises apart; to tell them apart: {rival.separate_by}")
