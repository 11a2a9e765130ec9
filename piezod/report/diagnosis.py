"""What a diagnosis found, as text for a terminal."""

from pathlib import Path

from piezod.diagnose.findings import Finding, Findings


def print_findings(findings: Findings, folder: Path) -> None:
    """Verdict, effects, rivals and notes as text.

    Parameters
    ----------
    findings
        Of a diagnosis.
    folder
        Where its files were written.
    """
    print(f"{findings.verdict.replace('_', ' ')}: {findings.words}")
    for one in findings.effects:
        _print_effect(one, findings.unit)
    for held in findings.held_out:
        print(f"  {held.path}, held out: {held.before:.4g} -> {held.after:.4g} {findings.unit}")
    if findings.not_testable:
        print(f"could not have been seen in these recordings: {', '.join(findings.not_testable)}")
    for note in findings.notes:
        print(f"note: {note}")
    print(f"{folder / 'findings.json'}, {folder / 'model.yaml'}, {folder / 'report.html'}")


def _print_effect(one: Finding, unit: str) -> None:
    scope = {"already": "already there when the model was identified", "since": "come since", "once": "once"}[one.scope]
    print(f"  {one.name} (confidence {100 * one.confidence:.0f} %, {scope}): {one.title}")
    for name, value in one.parameters.items():
        print(f"    {name:24} {value.value:12.5g}  {value.low:.4g} to {value.high:.4g} {value.unit}")
    for place in one.where:
        print(f"    seen at {place.axis} {place.low:.4g} to {place.high:.4g}")
    print(f"    held-out error {one.before:.4g} -> {one.after:.4g} {unit}")
    print(f"    {one.handling}" + (f": {one.why}" if one.why else ""))
    for rival in one.rivals:
        print(f"    rival {rival.name}, {rival.separation:.2g} noises apart; to tell them apart: {rival.separate_by}")
