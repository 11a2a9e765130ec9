"""Slow changes of parameters, from the estimates of each recording alone.

A diagnosis changes a value only where its recording excludes the old one. Many recordings together show a smaller
change. The test of Mann (1945) and Kendall (1975) compares their order and assumes no distribution. Their line has the
median slope of all pairs (Theil 1950, Sen 1968). R. O. Gilbert (1987), Statistical Methods for Environmental Pollution
Monitoring, chapter 16. Recordings of one hour share its drifts, and these count as changes.
"""

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from piezod.diagnose.findings import Value
from piezod.effects import EFFECTS
from piezod.history.changes import FALSE_ALARM
from piezod.history.parameters import Key
from piezod.model.parameters import BASE

FEWEST = 8
"""Estimates. Among five parameters, up to 3 of their 28 pairs may then be in the wrong order. With 6 estimates a wrong
pair would hide a trend."""
DAY_s = 86400.0


@dataclass(frozen=True)
class Estimate:
    """A parameter by one recording alone.

    Parameters
    ----------
    date
        Date of the recording in UTC.
    changed
        Whether the diagnosis of this recording states a change.
    """

    date: datetime
    value: Value
    changed: bool


@dataclass(frozen=True)
class Trend:
    """A slow change since the last stated change.

    Parameters
    ----------
    first, last
        Dates of its first and last recording in UTC.
    before, after
        Values of the line at these dates; their 95 % intervals follow from the slope.
    count
        Number of recordings.
    p
        Probability of such an order without a change.
    """

    key: Key
    first: datetime
    last: datetime
    before: Value
    after: Value
    count: int
    p: float

    def as_dict(self) -> dict[str, Any]:
        """The trend for JSON."""
        return {
            "parameter": str(self.key),
            "first": self.first.isoformat(),
            "last": self.last.isoformat(),
            "before": self.before.as_dict(),
            "after": self.after.as_dict(),
            "recordings": self.count,
            "p_value": self.p,
        }


def estimates_of(dated: Sequence[tuple[datetime, Mapping[str, Any]]]) -> dict[Key, list[Estimate]]:
    """Estimates of each parameter in the order of the dates.

    Parameters
    ----------
    dated
        Date and content of `findings.json` of each diagnosis; older versions state no estimates.
    """
    found: dict[Key, list[Estimate]] = {}
    for date, findings in sorted(dated, key=lambda pair: pair[0]):
        for key, (stated, changed) in _stated(findings).items():
            value = Value(stated["value"], stated["unit"], stated["low"], stated["high"])
            found.setdefault(key, []).append(Estimate(date, value, changed))
    return found


def trends_of(estimates: Mapping[Key, Sequence[Estimate]]) -> list[Trend]:
    """Significant trends, family-wise over all parameters with at least `FEWEST` estimates."""
    since = {key: _since_stated(some) for key, some in estimates.items()}
    tested = {key: some for key, some in since.items() if len(some) >= FEWEST}
    limit = FALSE_ALARM / max(len(tested), 1)
    trends = [_trend(key, some) for key, some in tested.items()]
    return [trend for trend in trends if trend.p < limit]


def _stated(findings: Mapping[str, Any]) -> dict[Key, tuple[Mapping[str, Any], bool]]:
    """Estimates in the findings of a diagnosis, and whether it states another value."""
    base, stated = findings.get("base", {}), dict[Key, tuple[Mapping[str, Any], bool]]()
    for name, value in base.get("measured", {}).items():
        stated[Key(BASE, name)] = value, base["status"] == "changed"
    for effect in findings.get("kept", ()):
        for name, value in effect.get("measured", {}).items():
            stated[Key(effect["name"], name)] = value, False
    for effect in findings.get("effects", ()):
        if effect.get("status") in ("new", "changed") and effect["name"] in EFFECTS:
            size = EFFECTS[effect["name"]].size.name
            if size in effect["parameters"]:
                stated[Key(effect["name"], size)] = effect["parameters"][size], True
    return stated


def _since_stated(estimates: Sequence[Estimate]) -> Sequence[Estimate]:
    """Estimates since the last stated change."""
    first = max((k for k, estimate in enumerate(estimates) if estimate.changed), default=0)
    return estimates[first:]


def _trend(key: Key, estimates: Sequence[Estimate]) -> Trend:
    stats = importlib.import_module("scipy.stats")  # late: it takes half a second
    first, last = estimates[0], estimates[-1]
    days = np.array([(estimate.date - first.date).total_seconds() / DAY_s for estimate in estimates])
    values = np.array([estimate.value.value for estimate in estimates])
    p = float(stats.kendalltau(days, values).pvalue) if np.ptp(values) > 0.0 and np.ptp(days) > 0.0 else 1.0
    slope, _, low, high = stats.theilslopes(values, days) if p < 1.0 else (0.0, 0.0, 0.0, 0.0)
    middle, centre = float(np.median(days)), float(np.median(values - slope * (days - np.median(days))))

    def at(day: float) -> Value:
        least, most = sorted(float(centre + one * (day - middle)) for one in (low, high))
        return Value(float(centre + slope * (day - middle)), first.value.unit, least, most)

    return Trend(key, first.date, last.date, at(0.0), at(float(days[-1])), len(estimates), p)
