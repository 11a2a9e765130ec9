"""The table of all methods on the same cases, compared with the truth, which is read last.

- gap closed: as `firmware_sim.concealed.scoring.case_score` defines it, against the noise-free held-out force, for the
  cases that it counts. A prediction that diverged was cut at the measured range, so it closes less than nothing; one
  that is missing closes nothing.
- made worse: of those cases, the held-out error is above the identified model's by more than 1 %.
- nulls, nothing said: no term beside the identified model; of `piezod`, no name and a verdict that nothing is there.
- nulls made worse: as above, of the nulls.
- names: of `piezod`, the exact set of effects, of the cases with effects of the catalogue alone. Of a peer, a kept term
  that the equation of a true effect has and that of no other effect. Of the terms that the peers are offered that holds
  for the temperature alone; every other one (r, u, base, du/dt and their products) stands for many effects.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from firmware_sim.concealed.scoring.case_score import CaseScore, HeldOut, gap_closed
from firmware_sim.concealed.scoring.study_score import score_study
from firmware_sim.concealed.scoring.verdicts import EXTENDED, read_simulation
from firmware_sim.concealed.study.seal import sealed_arrays, unpack_arrays
from firmware_sim.concealed.study.truth import TrueCase
from tests.studies.peers.run import PEERS, Answer, read_answer, read_prediction

BASE = "base"  # the identified model's simulation lies beside the predictions
WORSE = 1.01  # of the identified model's error
OWN_TERM, OWN_EFFECT = "temperature", "thermal_drift"
_COLUMNS = (
    "{method:<22} {median:>7} {low:>8} {of:>4} {worse:>7}  {nothing:>13} {nulls_worse:>7}  "
    "{diverged:>8} {failed:>6} {seconds:>6}  {names}"
)


@dataclass(frozen=True)
class CaseFigures:
    """One method on one case.

    Parameters
    ----------
    case, kind
        Name and kind of the case.
    gap
        Closed on the held-out record (1); None: not counted.
    worse
        Whether the identified model alone is better; None: nothing was predicted.
    nothing
        Whether it says that nothing is missing; None: it says nothing at all.
    said
        Terms or names.
    diverged, failed
        Whether the prediction diverged or is missing.
    seconds
        Duration: processor time of a peer, or the time in the verdict of `piezod` [s].
    """

    case: str
    kind: str
    gap: float | None
    worse: bool | None
    nothing: bool | None
    said: tuple[str, ...]
    diverged: bool
    failed: bool
    seconds: float


@dataclass(frozen=True)
class Row:
    """One method on all cases.

    Parameters
    ----------
    method
        Its name.
    names
        How often it names, in words.
    cases
        Its figures case by case.
    """

    method: str
    names: str
    cases: tuple[CaseFigures, ...]

    @property
    def gaps(self) -> list[float]:
        """Of the cases that count."""
        return [case.gap for case in self.cases if case.gap is not None]

    @property
    def worse(self) -> tuple[int, int]:
        """Made worse, of the cases whose gap counts."""
        return _count([case.worse for case in self.cases if case.gap is not None])

    @property
    def nulls_worse(self) -> tuple[int, int]:
        """Made worse, of the nulls."""
        return _count([case.worse for case in self.cases if case.kind == "null"])

    @property
    def nothing(self) -> tuple[int, int] | None:
        """Nulls of which it says that nothing is missing; None: it never says anything."""
        said = [case.nothing for case in self.cases if case.kind == "null"]
        return None if None in said else _count(said)

    def as_dict(self) -> dict[str, object]:
        """Everything, for `--json`."""
        gaps = self.gaps
        return {
            "method": self.method,
            "gap_median": float(np.median(gaps)) if gaps else None,
            "gap_10th_percentile": float(np.percentile(gaps, 10)) if gaps else None,
            "made_worse": self.worse,
            "nulls_nothing_said": self.nothing,
            "nulls_made_worse": self.nulls_worse,
            "names": self.names,
            "cases": [asdict(case) for case in self.cases],
        }

    def text(self) -> str:
        """One line."""
        gaps = self.gaps
        return _COLUMNS.format(
            method=self.method,
            median=f"{np.median(gaps):.3f}" if gaps else "-",
            low=f"{np.percentile(gaps, 10):.2f}" if gaps else "-",
            of=len(gaps),
            worse=_share(self.worse),
            nothing="-" if self.nothing is None else _of(self.nothing),
            nulls_worse=_of(self.nulls_worse),
            diverged=sum(case.diverged for case in self.cases),
            failed=sum(case.failed for case in self.cases),
            seconds=f"{np.median([case.seconds for case in self.cases]):.1f}",
            names=self.names,
        ).rstrip()


def header() -> str:
    """The line above the rows."""
    return _COLUMNS.format(
        method="method",
        median="gap",
        low="10th pc.",
        of="of",
        worse="worse",
        nothing="null: nothing",
        nulls_worse="worse",
        diverged="diverged",
        failed="failed",
        seconds="s",
        names="names",
    )


def table(study: Path, verdicts: Path, folder: Path, cases: Sequence[str], peers: Sequence[str]) -> list[Row]:
    """Judge what was predicted; opens the truth.

    Parameters
    ----------
    study, verdicts
        Of the cases, and what `piezod` said of them.
    folder
        With the answers of the peers and the identified model's simulations.
    cases
        Names of those that were asked about.
    peers
        Keys of `PEERS`.

    Raises
    ------
    StudyError
        The truth is not the one that was sealed.
    """
    judged = [each for each in score_study(study, verdicts, partial=True) if each.case.name in cases]
    true_N = {name: unpack_arrays(sealed_arrays(study, name).read_bytes())["held_out_true_N"] for name in cases}
    base_N = {name: read_prediction(folder / BASE / name) for name in cases}
    forces = {name: HeldOut(true_N[name], base_N[name], None) for name in cases}
    rows = [_of_piezod(judged, forces, verdicts)]
    return rows + [_of_peer(key, [each.case for each in judged], forces, folder / key) for key in peers]


def _of_piezod(judged: Sequence[CaseScore], forces: dict[str, HeldOut], verdicts: Path) -> Row:
    lines = []
    for each in judged:
        held_out = forces[each.case.name]
        extended_N = read_simulation(verdicts / each.case.name / EXTENDED, held_out.true_N.size)
        names = tuple(sorted(each.verdict.names))
        seconds = each.verdict.elapsed_s or math.nan
        lines.append(_line(each.case, held_out, extended_N, not each.alarm, names, Answer(busy_s=seconds)))
    named = _count([each.exact for each in judged if each.case.effects and not each.case.foreign])
    return Row("piezod", f"exact set {_of(named)}", tuple(lines))


def _of_peer(key: str, cases: Sequence[TrueCase], forces: dict[str, HeldOut], folder: Path) -> Row:
    peer, lines = PEERS[key], []
    for case in cases:
        answer = read_answer(peer, folder / case.name) or Answer(failed="no answer")
        nothing = not answer.terms and not answer.failed if peer.speaks else None
        lines.append(_line(case, forces[case.name], read_prediction(folder / case.name), nothing, answer.terms, answer))
    return Row(peer.name, _names(cases, lines) if peer.speaks else "does not name", tuple(lines))


def _line(
    case: TrueCase,
    held_out: HeldOut,
    predicted_N: np.ndarray | None,
    nothing: bool | None,
    said: tuple[str, ...],
    answer: Answer,
) -> CaseFigures:
    gap = gap_closed(case, HeldOut(held_out.true_N, held_out.base_N, predicted_N))
    worse = None
    if predicted_N is not None and held_out.base_N is not None:
        worse = _rms(predicted_N - held_out.true_N) > WORSE * _rms(held_out.base_N - held_out.true_N)
    failed = predicted_N is None
    return CaseFigures(case.name, case.kind, gap, worse, nothing, said, answer.diverged, failed, answer.busy_s)


def _names(cases: Sequence[TrueCase], lines: Sequence[CaseFigures]) -> str:
    """How often the one term that belongs to one effect is kept where that effect is, and where it is not."""
    kept = [any(OWN_TERM in term for term in line.said) for line in lines]
    there = [OWN_EFFECT in case.names for case in cases]
    right = _count([is_kept for is_kept, is_there in zip(kept, there, strict=True) if is_there])
    wrong = sum(is_kept and not is_there for is_kept, is_there in zip(kept, there, strict=True))
    return f"does not name, but for thermal drift: {_of(right)}, wrongly {wrong}"


def _count(hits: Sequence[bool | None]) -> tuple[int, int]:
    return sum(hit is True for hit in hits), len(hits)


def _of(count: tuple[int, int]) -> str:
    return f"{count[0]} of {count[1]}"


def _share(count: tuple[int, int]) -> str:
    return f"{100.0 * count[0] / count[1]:.0f} %" if count[1] else "-"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))
