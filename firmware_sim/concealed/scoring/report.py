"""A study's result as text and as JSON: the table, how effects were confused, calibration, and every failure."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from firmware_sim.concealed.scoring.figures import Bin, Figure, calibration_bins, figures
from firmware_sim.concealed.scoring.judge import Judgement
from firmware_sim.concealed.study.catalogue import ENTRIES

POOR_GAP = 0.9
POOR_PARAMETER = 0.3


@dataclass(frozen=True)
class Confusion:
    """How one effect fared.

    Parameters
    ----------
    effect
        Its name; foreign effects have lines of their own.
    true, named, rival
        In how many cases it is, is named, and is not named but among the rivals.
    false
        Cases in which it was named and is not.
    instead
        Wrong names that were given where it is missing, most frequent first.
    """

    effect: str
    true: int
    named: int
    rival: int
    false: int
    instead: tuple[tuple[str, int], ...]


def confusions(judged: Sequence[Judgement]) -> list[Confusion]:
    """One line an effect that is in the study or was named."""
    foreign = sorted({j.case.foreign for j in judged if j.case.foreign})
    lines = [_confusion(name, judged) for name in (*ENTRIES, *foreign)]
    return [line for line in lines if line.true or line.false]


def failures(judged: Sequence[Judgement]) -> list[str]:
    """One line for each case that is not as it should be."""
    lines = []
    for j in judged:
        why = _why(j)
        if why:
            lines.append(f"{j.case.name} {j.case.kind}: {_truth(j)} -> {_said(j)}: {', '.join(why)}")
    return lines


def as_json(judged: Sequence[Judgement]) -> dict[str, object]:
    """Everything that the text says, and each case's numbers."""
    return {
        "schema": "firmware_sim.concealed.score/1",
        "figures": [asdict(figure) | {"reached": figure.reached} for figure in figures(judged)],
        "confusion": [asdict(line) for line in confusions(judged)],
        "calibration": [asdict(each) for each in calibration_bins(judged)],
        "failures": failures(judged),
        "cases": {j.case.name: _case(j) for j in judged},
    }


def as_text(judged: Sequence[Judgement]) -> str:
    """The result for a terminal."""
    parts = [
        _table(["figure", "value", "95 %", "of", "at least", "aim", "reached"], [_row(f) for f in figures(judged)]),
        _table(["effect", "true", "named", "rival", "false", "named instead"], [_line(c) for c in confusions(judged)]),
        _table(["confidence", "names", "mean", "right"], [_bin(b) for b in calibration_bins(judged)]),
    ]
    wrong = failures(judged)
    return "\n\n".join([*parts, "\n".join([f"{len(wrong)} of {len(judged)} cases with a failure", *wrong])]) + "\n"


def _confusion(name: str, judged: Sequence[Judgement]) -> Confusion:
    there = [j for j in judged if name in j.case.names or name == j.case.foreign]
    named = [j for j in there if name in j.verdict.names]
    rival = [j for j in there if name in j.covered and name not in j.verdict.names]
    false = sum(name in j.verdict.names and name not in j.case.names for j in judged)
    wrong = Counter(
        other for j in there if name not in j.verdict.names for other in sorted(j.verdict.names - j.case.names)
    )
    return Confusion(name, len(there), len(named), len(rival), false, tuple(wrong.most_common(4)))


def _why(j: Judgement) -> list[str]:
    kind, why = j.case.kind, []
    if kind == "null":
        return ["false alarm"] if j.alarm else []
    if kind == "foreign":
        why += [] if j.verdict.flagged else ["not flagged"]
        why += ["sure name"] if j.sure_name else []
    elif not j.exact:
        missing, extra = sorted(j.case.names - j.verdict.names), sorted(j.verdict.names - j.case.names)
        why += [f"missing {' '.join(missing)}"] if missing else []
        why += [f"too many {' '.join(extra)}"] if extra else []
    elif j.verdict.flagged:
        why.append(f"solved, called {j.verdict.verdict}")
    why += [f"place not found ({p.effect} {p.place.axis} {p.place.low:.4g})" for p in j.places if not p.found]
    why += [f"{e.effect}.{e.parameter} off by {100 * e.error:.3g} %" for e in j.errors if e.error > POOR_PARAMETER]
    if j.gap_closed is not None and j.gap_closed < POOR_GAP:
        why.append(f"gap closed {j.gap_closed:.3f}")
    return why


def _truth(j: Judgement) -> str:
    names = [f"{e.name} {e.strength:g}x ({e.scope})" for e in j.case.effects]
    return " + ".join([*([j.case.foreign] if j.case.foreign else []), *names]) or "nothing"


def _said(j: Judgement) -> str:
    names = [f"{named.name} {named.confidence:.2f}" for named in j.verdict.effects]
    return f"{j.verdict.verdict} [{', '.join(names)}]"


def _case(j: Judgement) -> dict[str, object]:
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


def _row(figure: Figure) -> list[str]:
    def shown(value: float | None) -> str:
        if value is None:
            return "-"
        return f"{100 * value:.3g} %" if figure.percent else f"{value:.4g}"

    interval = "-".join(f"{100 * end:.0f}" for end in figure.interval) if figure.interval else ""
    sign = ">=" if figure.rising else "<="
    limits = [f"{sign} {shown(limit)}" for limit in (figure.least, figure.aim)]
    return [figure.name, shown(figure.value), interval, str(figure.count), *limits, figure.reached]


def _line(line: Confusion) -> list[str]:
    instead = ", ".join(f"{name} {count}" for name, count in line.instead)
    return [line.effect, *(str(n) for n in (line.true, line.named, line.rival, line.false)), instead]


def _bin(each: Bin) -> list[str]:
    return [f"{each.low:.1f}-{each.high:.1f}", str(each.count), f"{each.confidence:.3f}", f"{each.right:.3f}"]


def _table(head: list[str], rows: list[list[str]]) -> str:
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]
    )
