"""Runs the list: injects each fault, judges what was seen, and says so in a row."""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from tests.faults import at_start, at_work, in_hand, of_disk, of_files, of_process
from tests.faults.catalogue import Fault, load_faults
from tests.faults.probe import STILL_MS
from tests.faults.stand import CannotBeDoneHereError, Seen

INJECTORS: dict[str, Callable] = {
    **at_work.INJECTORS,
    **in_hand.INJECTORS,
    **at_start.INJECTORS,
    **of_process.INJECTORS,
    **of_files.INJECTORS,
    **of_disk.INJECTORS,
}
MOST_TRIES = 3  # of a fault during which the machine stood still
BEHIND = {"late_ms": 1.0, "behind_ms": STILL_MS}  # a reply held back for longer, a device woken later: another fault

COLUMNS = "{id:<4} {fault:<52.52} {expected:<17.17} {seen:<10.10} {after:>9} {bound:>8}  {verdict}"


@dataclass
class Result:
    """A fault and what came of it.

    Parameters
    ----------
    fault
        The row of the list.
    seen
        What came of it; None where it could not be injected.
    problems
        What is not as expected.
    skipped
        Why it could not be injected.
    lasted_s
        All in all.
    tries
        How often it was injected: again only when the machine stood still meanwhile.
    still_ms
        Longest standstill of the machine in the last try.
    """

    fault: Fault
    seen: Seen | None
    problems: list[str]
    skipped: str = ""
    lasted_s: float = 0.0
    tries: int = 1
    still_ms: float = 0.0

    @property
    def survived(self):
        return not self.problems and not self.skipped

    def text(self):
        """The row of the table."""
        fault, seen = self.fault, self.seen
        expected = fault.expect.state if fault.expect.state not in (None, "none") else ""
        if fault.expect.exit_code is not None:
            expected = f"{expected} exit {fault.expect.exit_code}".strip()
        verdict = (
            "survived" if self.survived else f"skipped: {self.skipped}" if self.skipped else "; ".join(self.problems)
        )
        if self.tries > 1:
            verdict += f" ({self.tries} tries, the machine stood still)"
        found = "" if seen is None else seen.state or ("" if seen.exit_code is None else f"exit {seen.exit_code}")
        return COLUMNS.format(
            id=fault.id,
            fault=fault.fault,
            expected=expected or "as counted",
            seen="" if found == "none" else found,
            after="" if seen is None else "stays" if seen.after_ms == 0.0 else f"{seen.after_ms:.0f} ms",
            bound=fault.within,
            verdict=verdict,
        )


def faults() -> tuple[Fault, ...]:
    """The list, checked against the injectors."""
    return load_faults(INJECTORS)


def run(fault: Fault, stand, probe) -> Result:
    """Inject one fault; again when it was not survived while the machine, or the device on it, stood still."""
    begun_s = time.monotonic()
    for tried in range(1, MOST_TRIES + 1):
        begun_ns = time.monotonic_ns()
        result = _once(fault, stand)
        result.tries, result.lasted_s = tried, time.monotonic() - begun_s
        figures = {} if result.seen is None else result.seen.figures
        stills = [probe.worst_ms(begun_ns) if probe else 0.0]
        stills += [figures[name] for name, most_ms in BEHIND.items() if figures.get(name, 0.0) > most_ms]
        result.still_ms = max(stills)
        if not result.problems or result.still_ms == 0.0:
            break
    return result


def _once(fault: Fault, stand) -> Result:
    try:
        seen = INJECTORS[fault.injector](stand, fault, **fault.parameters)
    except CannotBeDoneHereError as reason:
        return Result(fault, None, [], str(reason))
    except Exception as error:  # noqa: BLE001  # whatever the injector ran into, it is this fault that was not survived
        stand.drop()  # nothing is known of the benches
        where = traceback.extract_tb(error.__traceback__)[-1]
        return Result(fault, None, [f"{type(error).__name__}: {str(error)[:300]} ({where.name}, line {where.lineno})"])
    return Result(fault, seen, seen.judged(fault))


def header() -> str:
    """Names of the columns."""
    return COLUMNS.format(
        id="id", fault="fault", expected="expected", seen="seen", after="after", bound="bound", verdict="verdict"
    )


def summary(results: list[Result]) -> str:
    """What was not injected, aloud; armings; the count."""
    lines = [f"skipped {result.fault.id}: {result.skipped}" for result in results if result.skipped]
    lines += [f"instead {one.fault.id}: {' '.join(one.fault.instead.split())}" for one in results if one.fault.instead]
    run_ = [result for result in results if not result.skipped]
    armings = sum(result.seen.armings for result in run_ if result.seen is not None)
    judged = [result for result in run_ if result.seen is not None and result.seen.wrong is not None]
    outside = sum(bool(result.seen.wrong) for result in judged)
    lines.append(f"re-arms: {armings}; output outside its envelope: {outside} of the {len(judged)} where it was judged")
    lines.append(f"{sum(result.survived for result in run_)} of {len(run_)} faults survived")
    return "\n".join(lines)
