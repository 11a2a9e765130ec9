"""Result of a study as text and as JSON: figures, confusion of effects, calibration, and every failure."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from firmware_sim.concealed.scoring.case_score import CaseScore
from firmware_sim.concealed.scoring.figures import ConfidenceBin, Figure, calibration_bins, figures
from firmware_sim.concealed.study.catalogue import ENTRIES

POOR_GAP = 0.9
OUTSIDE = ("foreign", "unrecorded")  # kinds of cases with an effect outside the catalogue
POOR_PARAMETER = 0.3


@dataclass(frozen=True)
class Confusion:
    """Counts of one effect.

    Parameters
    ----------
    effect
        Name of the effect, catalogue or foreign.
    named
        Those of them in which it was named.
    rival
        Those of them in which it was among the rivals of a name.
    false
        Number of cases without the effect in which it was named.
    instead
        Wrong names in the cases where it was not named, most frequent first.
    """

    effect: str
    true: int
    named: int
    rival: int
    false: int
    instead: tuple[tuple[str, int], ...]


def confusions(scores: Sequence[CaseScore]) -> list[Confusion]:
    """One line for each effect that is in the study or was named.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    foreign = sorted({j.case.foreign for j in scores if j.case.foreign})
    lines = [_confusion(name, scores) for name in (*ENTRIES, *foreign)]
    return [line for line in lines if line.true or line.false]


def failures(scores: Sequence[CaseScore]) -> list[str]:
    """One line for each case with a failure.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    lines = []
    for j in scores:
        reasons = _failures_of_case(j)
        if reasons:
            lines.append(f"{j.case.name} {j.case.kind}: {_truth_text(j)} -> {_verdict_text(j)}: {', '.join(reasons)}")
    return lines


def as_json(scores: Sequence[CaseScore]) -> dict[str, object]:
    """Content of `as_text`, and the numbers of every case.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    return {
        "schema": "firmware_sim.concealed.score/1",
        "figures": [asdict(figure) | {"reached": figure.reached} for figure in figures(scores)],
        "confusion": [asdict(line) for line in confusions(scores)],
        "calibration": [asdict(each) for each in calibration_bins(scores)],
        "failures": failures(scores),
        "cases": {j.case.name: _case(j) for j in scores},
    }


def as_text(scores: Sequence[CaseScore]) -> str:
    """Result for a terminal.

    Parameters
    ----------
    scores
        Score of every case of the study.
    """
    parts = [
        figure_table(figures(scores)),
        table(
            ["effect", "true", "named", "rival", "false", "named instead"],
            [_confusion_row(c) for c in confusions(scores)],
        ),
        table(["confidence", "names", "mean", "right"], [_bin_row(b) for b in calibration_bins(scores)]),
    ]
    families = sorted({score.case.family for score in scores} - {""})
    if families:
        header = ["family", "nulls", "false alarms", "others", "exact set", "foreign", "flagged"]
        parts.insert(1, table(header, [_family_row(name, scores) for name in families]))
    failed = failures(scores)
    return "\n\n".join([*parts, "\n".join([f"{len(failed)} of {len(scores)} cases with a failure", *failed])]) + "\n"


def _family_row(name: str, scores: Sequence[CaseScore]) -> list[str]:
    """Cases of a family by kind, and how many of each are right or wrong."""
    mine = [score for score in scores if score.case.family == name]
    nulls = [score for score in mine if score.case.kind == "null"]
    foreign = [score for score in mine if score.case.kind in OUTSIDE]
    others = [score for score in mine if score.case.kind not in ("null", *OUTSIDE)]
    counts = (
        len(nulls),
        sum(score.alarm for score in nulls),
        len(others),
        sum(score.exact for score in others),
        len(foreign),
        sum(score.verdict.flagged for score in foreign),
    )
    return [name, *map(str, counts)]


def _confusion(name: str, scores: Sequence[CaseScore]) -> Confusion:
    true = [j for j in scores if name in j.case.names or name == j.case.foreign]
    named = [j for j in true if name in j.verdict.names]
    rival = [j for j in true if name in j.covered and name not in j.verdict.names]
    false = sum(name in j.verdict.names and name not in j.case.names for j in scores)
    wrong = Counter(
        other for j in true if name not in j.verdict.names for other in sorted(j.verdict.names - j.case.names)
    )
    return Confusion(name, len(true), len(named), len(rival), false, tuple(wrong.most_common(4)))


def _failures_of_case(j: CaseScore) -> list[str]:
    kind, reasons = j.case.kind, []
    if kind == "null":
        return ["false alarm"] if j.alarm else []
    if kind in OUTSIDE:
        reasons += [] if j.verdict.flagged else ["not flagged"]
        reasons += ["confident name"] if j.confident_name else []
    elif not j.exact:
        missing, extra = sorted(j.case.names - j.verdict.names), sorted(j.verdict.names - j.case.names)
        reasons += [f"missing {' '.join(missing)}"] if missing else []
        reasons += [f"too many {' '.join(extra)}"] if extra else []
    elif j.verdict.flagged:
        reasons.append(f"solved, called {j.verdict.verdict}")
    reasons += [f"place not found ({p.effect} {p.place.axis} {p.place.low:.4g})" for p in j.places if not p.found]
    reasons += [f"{e.effect}.{e.parameter} off by {100 * e.error:.3g} %" for e in j.errors if e.error > POOR_PARAMETER]
    if j.gap_closed is not None and j.gap_closed < POOR_GAP:
        reasons.append(f"gap closed {j.gap_closed:.3f}")
    return reasons


def _truth_text(j: CaseScore) -> str:
    names = [f"{e.name} {e.strength:g}x ({e.scope})" for e in j.case.effects]
    return " + ".join([*([j.case.foreign] if j.case.foreign else []), *names]) or "nothing"


def _verdict_text(j: CaseScore) -> str:
    names = [f"{named.name} {named.confidence:.2f}" for named in j.verdict.effects]
    return f"{j.verdict.verdict} [{', '.join(names)}]"


def _case(j: CaseScore) -> dict[str, object]:
    return {
        "kind": j.case.kind,
        "truth": sorted(j.case.names),
        "foreign": j.case.foreign,
        "strengths": {effect.name: effect.strength for effect in j.case.effects},
        "verdict": j.verdict.verdict,
        "named": {named.name: named.confidence for named in j.verdict.effects},
        "exact": j.exact,
        "covered": sorted(j.covered),
        "gap_closed": j.gap_closed,
        "errors": {f"{e.effect}.{e.parameter}": e.error for e in j.errors},
        "places": [{"effect": p.effect, **asdict(p.place), "found": p.found} for p in j.places],
        "elapsed_s": j.verdict.elapsed_s,
    }


def _figure_row(figure: Figure) -> list[str]:
    def shown(value: float | None) -> str:
        if value is None:
            return "-"
        return f"{100 * value:.3g} %" if figure.percent else f"{value:.4g}"

    interval = "-".join(f"{100 * end:.0f}" for end in figure.interval) if figure.interval else ""
    sign = ">=" if figure.rising else "<="
    limits = [f"{sign} {shown(limit)}" for limit in (figure.least, figure.aim)]
    return [figure.name, shown(figure.value), interval, str(figure.count), *limits, figure.reached]


def _confusion_row(line: Confusion) -> list[str]:
    instead = ", ".join(f"{name} {count}" for name, count in line.instead)
    return [line.effect, *(str(n) for n in (line.true, line.named, line.rival, line.false)), instead]


def _bin_row(each: ConfidenceBin) -> list[str]:
    return [f"{each.low:.1f}-{each.high:.1f}", str(each.count), f"{each.confidence:.3f}", f"{each.right:.3f}"]


def figure_table(figures: Sequence[Figure]) -> str:
    """Table with a row for each figure: value, interval, count, requirement, aim."""
    return table(["figure", "value", "95 %", "of", "at least", "aim", "reached"], [_figure_row(f) for f in figures])


def table(head: list[str], rows: list[list[str]]) -> str:
    """Table with columns as wide as their cells."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
    )
