"""Comparison of a proof test with the previous test: the changes of each step, and the as-found run.

The first run of a day (UTC) shows the bench as it was found, before any repair; the last one shows it as it was left.
"""

from typing import Any


def compare(record: dict[str, Any], earlier: list[dict[str, Any]]) -> dict[str, Any]:
    """Part of the record that compares it with the last earlier one.

    Parameters
    ----------
    earlier
        Records of the bench, oldest first; later records are ignored.

    Returns
    -------
    dict
        `as_found_utc`, the date of the first record of the same day; `compared_with`, date, tester and result of the
        last earlier record, or None; `changes`, by the name of the step.
    """
    earlier = [past for past in earlier if past["date_utc"] < record["date_utc"]]
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
