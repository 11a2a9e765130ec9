"""The dated record of a proof test: bench, device, version, and each step with its measured value and limit."""

import os
import pwd
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from piezod import __version__
from piezod.commissioning.proof.comparison import change_text
from piezod.commissioning.proof.coverage import coverage
from piezod.config import BenchConfig
from piezod.daemon.proof_date import DATE, SCHEMA, proven_sections
from piezod.errors import ConfigurationError, UsageError
from piezod.transport import Link

Result = Literal["pass", "fail", "skipped"]


@dataclass(frozen=True)
class ProofStep:
    """Result of one step.

    Parameters
    ----------
    result
        `pass`, `fail`, or `skipped`: this bench has no such function.
    measured, limit
        Measured value and its limit, in `unit`; None where nothing was measured.
    unit
        Unit of both.
    time_ms
        Duration that the step measured [ms]; None without one.
    detail
        Action, or reason of a failure.
    """

    name: str
    result: Result
    measured: float | None = None
    limit: float | None = None
    unit: str = ""
    time_ms: float | None = None
    detail: str = ""


@dataclass(frozen=True)
class ProofEnd:
    """The steps that were done, and the end of the test.

    Parameters
    ----------
    steps
        Results in their order.
    rest_failure
        Failure to bring the bench to rest; empty: it is at rest.
    interrupted
        Whether Ctrl-C or SIGTERM ended the test.
    """

    steps: list[ProofStep]
    rest_failure: str
    interrupted: bool


def word(right: bool) -> Result:
    """Result of a step that was done."""
    return "pass" if right else "fail"


def skipped(name: str, reason: str) -> ProofStep:
    """Result of a step that this bench cannot prove, with the reason."""
    return ProofStep(name, "skipped", detail=reason)


def record_path(bench: BenchConfig, output: Path | None, now: datetime) -> Path:
    """Path of the record: `output`, or NAME-proof-DATE.json in the present folder.

    Raises
    ------
    UsageError
        The file exists already; a record is never replaced.
    ConfigurationError
        The folder does not exist, or cannot be written.
    """
    path = output or Path(f"{bench.name}-proof-{now:%Y%m%dT%H%M%SZ}.json")
    check_target(path)
    return path


def check_target(path: Path) -> None:
    """Check that a record can be written, before anything else is done.

    Raises
    ------
    UsageError
        The file exists already; a record is never replaced.
    ConfigurationError
        The folder does not exist, or cannot be written.
    """
    if os.path.lexists(path):
        raise UsageError(f"{path} already exists, and a record is never replaced; name another file with -o")
    if not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
        raise ConfigurationError(f"{path.parent}: no folder that this user can write; name another file with -o")


def utc_now() -> datetime:
    """Present time of day, UTC."""
    return datetime.now(UTC)


def make_record(
    bench: BenchConfig, link: Link, end: ProofEnd, now: datetime, planned: tuple[str, ...], tester: str = ""
) -> dict[str, Any]:
    """Make the record; it has passed when every planned step was done, none failed, and the bench is at rest.

    Parameters
    ----------
    bench, link
        Bench configuration and its opened link.
    end
        Steps that were done, and the end.
    now
        Time of the begin, UTC.
    planned
        Names of the steps that belong to a complete test.
    tester
        Name of the person who tests; empty: the user of this process.
    """
    complete = tuple(step.name for step in end.steps) == planned and not end.interrupted
    passed = complete and not end.rest_failure and all(step.result != "fail" for step in end.steps)
    return {
        "schema": SCHEMA,
        "bench": bench.name,
        "device": link.description,
        "identity": _identity(link),
        "proven": proven_sections(bench),
        "version": __version__,
        "tester": tester or _user(),
        "date_utc": f"{now:{DATE}}",
        "coverage": coverage(bench, {step.name: step.result for step in end.steps}),
        "steps": [_finite(asdict(step)) for step in end.steps],
        "left_at_rest": not end.rest_failure,
        "remark": end.rest_failure or ("interrupted" if end.interrupted else ""),
        "passed": passed,
    }


def text_lines(record: dict[str, Any]) -> Iterator[str]:
    """The record as lines for a terminal."""
    yield f"{record['bench']}: {record['device']}, {record['date_utc']}, piezod {record['version']}"
    changes = record.get("changes") or {}
    if earlier := record.get("compared_with"):
        result = "passed" if earlier["passed"] else "not passed"
        yield f"tested by {record['tester']}; compared with {earlier['date_utc']} by {earlier['tester']}, {result}"
    for step in record["steps"]:
        if step["result"] == "skipped":
            yield f"NOT PROVEN  {step['name']}: {step['detail']}"
            yield from _change_lines(changes, step)
            continue
        value = ""
        if step["measured"] is not None:
            value = f" {step['measured']:.4g} {step['unit']}, limit {step['limit']:.4g} {step['unit']}"
        time = "" if step["time_ms"] is None else f", {step['time_ms']:.1f} ms"
        yield f"{step['result'].upper():8}{step['name']}:{value}{time}; {step['detail']}"
        yield from _change_lines(changes, step)
    yield record["coverage"]["text"]
    for name, reason in record["coverage"]["not_proven"].items():
        yield f"NOT PROVEN  {name}: {reason}"
    if record["remark"]:
        yield f"FAIL    end: {record['remark']}"


def _change_lines(changes: dict[str, Any], step: dict[str, Any]) -> Iterator[str]:
    """Line on this step in the earlier record."""
    change = changes.get(step["name"])
    if change is not None and not change["before"] == change["now"] == "skipped":
        yield f"        before: {change_text(change)}"


def _user() -> str:
    """Name of the user of this process; the number of one without a name."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())


def _finite(step: dict[str, Any]) -> dict[str, Any]:
    """Replace values that JSON does not know: nothing was measured, or the time was endless."""
    return {key: None if isinstance(value, float) and not isfinite(value) else value for key, value in step.items()}


def _identity(link: Link) -> dict[str, float]:
    """Registers of identity that the device has; they were compared with the configuration before."""
    roles = ("identity", "map_version")
    return {role: link.read_register(role) for role in roles if link.has(role)}
