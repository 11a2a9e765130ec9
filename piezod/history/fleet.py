"""Comparison of the benches of an archive: their newest parameters, and the benches unlike the others."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median
from typing import Any

from piezod.diagnose.findings import Value
from piezod.diagnose.verdict.words import PER, listed
from piezod.history.archive_run import BenchRun, Diagnosed
from piezod.history.changes import HALF_95
from piezod.history.parameters import Key
from piezod.history.timeline import Timeline, timeline_of
from piezod.history.trends import Estimate, Trend, estimates_of, trends_of
from piezod.history.words import number, trend_words, verdict_of, wording_of

SCHEMA = "piezod.fleet/1"
OUTLIER = 3.5
"""Distance from the median over the spread beyond which a bench stands out.

Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993), chapter 3: modified z-scores.
"""
DEVIATION_PER_MAD = 1.4826  # standard deviation over median absolute deviation, for normal values
FEWEST_BENCHES = 5  # for a spread: four values have the median absolute deviation of two
FLAGGED = ("unexplained", "partly_explained")


@dataclass(frozen=True)
class BenchState:
    """A bench after its newest recording.

    Parameters
    ----------
    timeline
        Its models in order.
    words
        Its changes over time in a sentence.
    estimates
        Estimates of each recording alone, of recordings with a date.
    trends
        Slow changes that these show.
    """

    run: BenchRun
    timeline: Timeline
    words: str
    estimates: Mapping[Key, Sequence[Estimate]]
    trends: Sequence[Trend]

    @property
    def name(self) -> str:
        """Name of the bench."""
        return self.run.bench.name

    @property
    def parameters(self) -> dict[Key, Value]:
        """Parameters of the newest model, with intervals."""
        return self.timeline.steps[-1].parameters

    @property
    def newest(self) -> Diagnosed | None:
        """Newest recording that was diagnosed; None: there is none."""
        return next((diagnosed for diagnosed in reversed(self.run.done) if diagnosed.findings is not None), None)

    @property
    def verdict(self) -> str:
        """Verdict on the newest recording; "-" without one."""
        newest = self.newest
        return "-" if newest is None or newest.findings is None else str(newest.findings["verdict"])

    @property
    def failed(self) -> list[Diagnosed]:
        """Recordings that could not be diagnosed."""
        return [diagnosed for diagnosed in self.run.done if diagnosed.failed is not None]


@dataclass(frozen=True)
class Fleet:
    """All benches of an archive, by name."""

    benches: tuple[BenchState, ...]

    @classmethod
    def of(cls, runs: Sequence[BenchRun]) -> "Fleet":
        """States of the benches after a run."""
        states = []
        for run in runs:
            timeline, estimates = timeline_of(run.model_paths), estimates_of(_dated(run.done))
            trends = trends_of(estimates)
            single = len(timeline.steps) == 1 and not trends
            words = f"nothing changed in {len(run.done)} recordings" if single else verdict_of(timeline, trends)
            states.append(BenchState(run, timeline, words, estimates, trends))
        return cls(tuple(states))

    @property
    def keys(self) -> list[Key]:
        """Parameters of all benches, the base first."""
        return list(dict.fromkeys(key for bench in self.benches for key in bench.parameters))

    @property
    def recordings(self) -> int:
        """Number of recordings, with those that could not be diagnosed."""
        return sum(len(bench.run.done) for bench in self.benches)

    @property
    def stands_out(self) -> list[str]:
        """A sentence for each bench or parameter that is unlike the others."""
        lines = [line for key in self.keys for line in self._outliers(key)]
        lines += self._rare_effects()
        for bench in self.benches:
            wording = wording_of(bench.timeline.steps[-1].entry.model)
            lines += [f"{bench.name}: {trend_words(trend, wording)}" for trend in bench.trends]
            if bench.verdict in FLAGGED:
                lines.append(f"{bench.name}: the newest recording is {bench.verdict.replace('_', ' ')}")
        return lines

    @property
    def verdict(self) -> str:
        """Number of benches and recordings, and of benches that changed, in a sentence."""
        changed = sum(len(bench.timeline.steps) > 1 for bench in self.benches)
        failed = sum(len(bench.failed) for bench in self.benches)
        damaged = f"; {failed} recordings could not be diagnosed" if failed else ""
        count = len(self.stands_out)
        return (
            f"{self.recordings} recordings of {len(self.benches)} benches; benches that changed: {changed}; "
            f"what stands out: {count or 'nothing'}{damaged}"
        )

    def outlying(self, key: Key) -> set[str]:
        """Names of the benches whose parameter is far from the median, relative to the spread of all benches."""
        values = {bench.name: bench.parameters[key] for bench in self.benches if key in bench.parameters}
        if len(values) < FEWEST_BENCHES:
            return set()
        middle = median(value.value for value in values.values())
        spread = DEVIATION_PER_MAD * median(abs(value.value - middle) for value in values.values())
        return {name for name, value in values.items() if _distance(value, middle, spread) > OUTLIER}

    def as_dict(self) -> dict[str, Any]:
        """The fleet for JSON."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "stands_out": self.stands_out,
            "benches": {bench.name: _bench_as_dict(bench) for bench in self.benches},
        }

    def _outliers(self, key: Key) -> list[str]:
        names = self.outlying(key)
        values = sorted(bench.parameters[key].value for bench in self.benches if key in bench.parameters)
        lines = []
        for bench in self.benches:
            if bench.name in names:
                value = bench.parameters[key]
                wording = wording_of(bench.timeline.steps[-1].entry.model)
                middle = number(key, Value(median(values), value.unit, median(values), median(values)), wording)
                heading = key.title if key.label(value.unit).startswith(PER) else key.heading(value.unit)
                lines.append(f"{bench.name}: {heading} is {number(key, value, wording)}, the median is {middle}")
        return lines

    def _rare_effects(self) -> list[str]:
        """Effects that less than half of at least `FEWEST_BENCHES` benches have."""
        if len(self.benches) < FEWEST_BENCHES:
            return []
        titles = dict.fromkeys((key.effect, key.title) for key in self.keys)
        lines = []
        for effect, title in titles:
            having = [bench.name for bench in self.benches if any(key.effect == effect for key in bench.parameters)]
            if 2 * len(having) < len(self.benches):
                verb = "has" if len(having) == 1 else "have"
                lines.append(f"only {listed(having)} {verb} {title}")
        return lines


def _dated(done: Sequence[Diagnosed]) -> list[tuple[datetime, dict[str, Any]]]:
    """Date and findings of each recording that has both."""
    pairs = ((one.recording.date, one.findings) for one in done)
    return [(date, findings) for date, findings in pairs if date is not None and findings is not None]


def _distance(value: Value, middle: float, spread: float) -> float:
    """Distance of a value from the median, over its own standard error and the spread of the benches."""
    own = (value.high - value.low) / (2.0 * HALF_95)
    scale = math.hypot(spread, own)
    return abs(value.value - middle) / scale if scale > 0.0 else 0.0


def _bench_as_dict(bench: BenchState) -> dict[str, Any]:
    return {
        "verdict": bench.verdict,
        "words": bench.words,
        "trends": [trend.as_dict() for trend in bench.trends],
        "model": str(bench.run.model_path),
        "recordings": [
            {
                "path": str(diagnosed.recording.path),
                "date": None if diagnosed.recording.date is None else diagnosed.recording.date.isoformat(),
                "verdict": None if diagnosed.findings is None else diagnosed.findings["verdict"],
                "failed": diagnosed.failed,
                "cpu_s": diagnosed.cpu_s,
            }
            for diagnosed in bench.run.done
        ],
        "parameters": {str(key): value.as_dict() for key, value in bench.parameters.items()},
    }
