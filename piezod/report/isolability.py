"""Isolability of the effects by recordings, as text and JSON."""

from collections.abc import Sequence
from typing import Any

from piezod.diagnose.experiment.isolability import LARGE, Isolability
from piezod.diagnose.experiment.planning import Experiment
from piezod.diagnose.verdict.words import listed, unit_words

MOST_PAIRS = 12


def isolability_as_dict(result: Isolability, unit: str) -> dict[str, Any]:
    """The result for JSON."""
    return {
        "schema": "piezod.isolability/1",
        "noise": {"value": result.noise, "unit": unit},
        "effects": list(result.effects),
        "seen_from_noises": dict(zip(result.effects, result.seen_from.tolist(), strict=True)),
        "separated_from_noises": result.separated_from.tolist(),
        "unseen": list(result.unseen),
        "groups": [list(group) for group in result.groups()],
        "pairs": [
            {"first": pair.first, "second": pair.second, "from_noises": pair.size, "separate_by": pair.separate_by}
            for pair in result.pairs()
        ],
        "notes": list(result.notes),
    }


def isolability_text(result: Isolability, unit: str) -> str:
    """The result for a terminal."""
    groups, hidden, pairs = result.groups(), result.unseen, result.pairs()
    alone = len(result.effects) - len(hidden) - sum(len(group) for group in groups)
    separated = f"of {len(result.effects)} effects these recordings separate {alone} from all others"
    large = f"{LARGE * result.noise:.3g} {unit_words(unit)} rms"
    lines = [f"{separated} when they change the reading by {LARGE:g} times the noise, {large}"]
    lines += [f"not separable: {listed(group, 'or')}" for group in groups]
    if hidden:
        lines.append(f"not seen: {listed(hidden)}")
    lines += ["", f"{'effect':26}seen from [noise]"]
    lines += [f"{name:26}{size:.2g}" for name, size in zip(result.effects, result.seen_from, strict=True)]
    if pairs:
        lines += ["", f"{'pair':53}separated from [noise]  by"]
        lines += [f"{p.first:26} {p.second:26}{p.size:22.2g}  {p.separate_by}" for p in pairs[:MOST_PAIRS]]
        if len(pairs) > MOST_PAIRS:
            lines.append(f"and {len(pairs) - MOST_PAIRS} more pairs; --json prints all")
    return "\n".join([*lines, *(f"note: {note}" for note in result.notes)])


def experiment_as_dict(planned: Experiment) -> dict[str, Any]:
    """An experiment for JSON."""
    return {
        "duration_s": planned.voltage_V.size * planned.dt_s,
        "segments": list(planned.segments),
        "pairs": [
            {"first": pair.first, "second": pair.second, "from_noises": pair.size, "then_from_noises": size}
            for pair, size in zip(planned.pairs, planned.sizes, strict=True)
        ],
    }


def promise_text(planned: Experiment, reached: Sequence[float]) -> str:
    """Planned and reached separation of the pairs, after an experiment.

    Parameters
    ----------
    reached
        Sizes from which on its pairs are separated with the recording, in noises.
    """
    lines = [f"{'pair':53}separated from [noise]  promised  reached"]
    for pair, promised, size in zip(planned.pairs, planned.sizes, reached, strict=True):
        lines.append(f"{pair.first:26} {pair.second:26}{pair.size:22.2g}  {promised:8.2g}  {size:7.2g}")
    return "\n".join(lines)


def experiment_text(planned: Experiment | None, name: str) -> str:
    """An experiment for a terminal.

    Parameters
    ----------
    name
        Name of the file with the drive.
    """
    if planned is None:
        return "no pair of effects is open: no further experiment is needed, and none is written"
    duration_s = planned.voltage_V.size * planned.dt_s
    lines = [
        f"{name}: {duration_s:.0f} s, {', '.join(dict.fromkeys(planned.segments))}; piezod record --excitation {name}"
    ]
    lines.append(f"{'pair':53}separated from [noise]  with it")
    for pair, size in list(zip(planned.pairs, planned.sizes, strict=True))[:MOST_PAIRS]:
        lines.append(f"{pair.first:26} {pair.second:26}{pair.size:22.2g}  {size:7.2g}")
    return "\n".join(lines)
