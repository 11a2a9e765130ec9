"""Comparison of a proof test with the previous test: the changes of each step, and the as-found run.

The first run of a day (UTC) shows the bench as it was found, before any repair; the last one shows it as it was left.
"""

import json
from datetime import datetime
from math import isfinite
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.regular_file import open_regular
from piezod.errors import PiezodError

LARGEST_BYTES = 1 << 20  # largest record; a proof test has a few kilobytes
_DATE = "%Y-%m-%dT%H:%M:%SZ"


def earlier_records(bench: BenchConfig, folder: Path, now: datetime) -> list[dict[str, Any]]:
    """Records of the bench from before `now`, oldest first; other files are ignored.

    Parameters
    ----------
    folder
        Folder of the records, `proof.folder`.
    now
        Begin of the present test, UTC.
    """
    records = [_record(path, bench.name) for path in folder.glob(f"{bench.name}-proof-*.json")]
    before = f"{now:{_DATE}}"
    return sorted(
        (record for record in records if record is not None and record["date_utc"] < before),
        key=lambda record: str(record["date_utc"]),
    )


def compare(record: dict[str, Any], earlier: list[dict[str, Any]]) -> dict[str, Any]:
    """Part of the record that compares it with the last earlier one.

    Parameters
    ----------
    earlier
        Earlier records, oldest first.

    Returns
    -------
    dict
        `as_found_utc`, the date of the first record of the same day; `compared_with`, date, tester and result of the
        last earlier record, or None; `changes`, by the name of the step.
    """
    same_day = [past["date_utc"] for past in earlier if past["date_utc"][:10] == record["date_utc"][:10]]
    first_utc = same_day[0] if same_day else record["date_utc"]
    if not earlier:
        return {"as_found_utc": first_utc, "compared_with": None, "changes": {}}
    last = earlier[-1]
    before = {step["name"]: step for step in last["steps"]}
    changes = {step["name"]: _change(before.get(step["name"]), step) for step in record["steps"]}
    compared_with = {key: last.get(key) for key in ("date_utc", "tester", "version", "passed")}
    return {"as_found_utc": first_utc, "compared_with": compared_with, "changes": changes}


def change_text(change: dict[str, Any]) -> str:
    """Words for the change of one step.

    Parameters
    ----------
    change
        Value of `changes`.
    """
    if change["before"] is None:
        return "not in the earlier record"
    text = str(change["before"]) if change["before"] == change["now"] else f"{change['before']} -> {change['now']}"
    if change["measured_before"] is None:
        return text
    text += f", {change['measured_before']:.4g} {change['unit']}"
    share = change["change_of_limit"]
    return text if share is None else f"{text}, since then {100 * share:+.1f} % of its limit"


def _change(before: dict[str, Any] | None, step: dict[str, Any]) -> dict[str, Any]:
    former = before or {"result": None, "measured": None, "limit": None}
    shares = [_share(result["measured"], result["limit"]) for result in (former, step)]
    known = [share for share in shares if share is not None]
    return {
        "before": former["result"],
        "now": step["result"],
        "measured_before": former["measured"],
        "unit": step["unit"],
        "change_of_limit": known[1] - known[0] if len(known) == len(shares) else None,
    }


def _share(measured: float | None, limit: float | None) -> float | None:
    return measured / limit if measured is not None and limit else None


def _record(path: Path, name: str) -> dict[str, Any] | None:
    """A record of the bench; None for any other file."""
    try:
        with open_regular(path, LARGEST_BYTES) as file:
            record: dict[str, Any] = json.load(file)
        datetime.strptime(record["date_utc"], _DATE)  # noqa: DTZ007  # only its form is checked
        valid = record["bench"] == name and all(_is_step(step) for step in record["steps"])
    except (PiezodError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return record if valid else None


def _is_step(step: dict[str, Any]) -> bool:
    numbers = [step["measured"], step["limit"]]
    known = all(value is None or (isinstance(value, int | float) and isfinite(value)) for value in numbers)
    return known and isinstance(step["name"], str) and isinstance(step["result"], str)
