"""Injection of the listed faults, and the table of their results."""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from tests.faults import (
    access_faults,
    blocked_stops,
    device_faults,
    disk_faults,
    input_faults,
    manual_clock_faults,
    process_faults,
    running_faults,
    session_faults,
    startup_faults,
)
from tests.faults.bench_pool import InjectionUnavailableError, Observation
from tests.faults.catalogue import Fault, load_faults
from tests.faults.kills import READY_WITHIN_MS
from tests.faults.probe import STILL_MS
from tests.simulation.row_cases import INJECTORS as SIMULATED
from tests.simulation.rows import OF_PROCESSES, rows

INJECTORS: dict[str, Callable] = {
    **running_faults.INJECTORS,
    **manual_clock_faults.INJECTORS,
    **device_faults.INJECTORS,
    **startup_faults.INJECTORS,
    **process_faults.INJECTORS,
    **session_faults.INJECTORS,
    **input_faults.INJECTORS,
    **disk_faults.INJECTORS,
    **access_faults.INJECTORS,
    **blocked_stops.INJECTORS,
}
INPUTS_OF_A_BENCH = {"metrics", "control_socket", "hostile_clients", "secrets"}
IN_PROCESS = {*manual_clock_faults.INJECTORS, *device_faults.INJECTORS, *input_faults.INJECTORS} - INPUTS_OF_A_BENCH
"""Injectors that use no running bench, whose results do not depend on the real clock."""

ONLY_A_PROCESS_SHOWS = {
    "exit code": "T1",
    "terminal": "P10",
    "second master": "S11",
    "clock": "M4",
    "signal": "R1",
    "kill": "R4",
    "systemd": "R7",
    "lock": "R9",
    "pipe": "R21",
    "socket queue": "R29",
}
"""Facts that virtual time cannot show, and the row that shows each with real processes. The simulation
judges these rows too, and every other row that it can run; a row that it cannot run is slow, if it needs processes."""
MOST_TRIES = 5  # largest number of injections of a fault that is not survived in real time
FAILURES = 2  # failures on a fit machine that are believed; delays of a few milliseconds leave no other trace
CONTROL_S = 1.0
NOT_JUDGED = "not judged"  # how such a reason to skip a fault begins
EXCESS_DELAY = {"behind_ms": STILL_MS}  # of a wake-up [ms]; beyond, a failure is repeated

FIELDS = ("id", "fault", "expected", "observed", "after", "bound", "verdict")
COLUMNS = "{id:<4} {fault:<52.52} {expected:<17.17} {observed:<10.10} {after:>9} {bound:>8}  {verdict}"


@dataclass
class Result:
    """A fault and its result.

    Parameters
    ----------
    fault
        The row of the list.
    seen
        Observed result; None where it could not be injected.
    problems
        Deviations from the expected result.
    skipped
        Reason why it could not be injected; empty otherwise.
    lasted_s
        Duration of all tries [s].
    tries
        Number of injections; a failure in real time is repeated.
    unfit
        What the machine did during the failures: it stood still, or the bench failed without a fault too.
    """

    fault: Fault
    observed: Observation | None
    problems: list[str]
    skipped: str = ""
    lasted_s: float = 0.0
    tries: int = 1
    unfit: str = ""

    @property
    def survived(self):
        return not self.problems and not self.skipped

    def text(self):
        """The row of the table."""
        fault, observed = self.fault, self.observed
        expected = fault.expect.state if fault.expect.state not in (None, "none") else ""
        if fault.expect.exit_code is not None:
            expected = f"{expected} exit {fault.expect.exit_code}".strip()
        verdict = (
            "survived" if self.survived else f"skipped: {self.skipped}" if self.skipped else "; ".join(self.problems)
        )
        if self.tries > 1:
            verdict += f" ({self.tries} tries{'; ' if self.unfit else ''}{self.unfit})"
        found = (
            ""
            if observed is None
            else observed.state or ("" if observed.exit_code is None else f"exit {observed.exit_code}")
        )
        return COLUMNS.format(
            id=fault.id,
            fault=fault.fault,
            expected=expected or "figures",
            observed="" if found == "none" else found,
            after="" if observed is None else "stays" if observed.after_ms == 0.0 else f"{observed.after_ms:.0f} ms",
            bound=fault.within,
            verdict=verdict,
        )


def faults() -> tuple[Fault, ...]:
    """The listed faults that run outside the simulation, checked against the injectors.

    A fault that is simulated has a live copy where only a process shows its fact, or has one of its figures.
    """
    simulated, live = rows(), {*ONLY_A_PROCESS_SHOWS.values()}
    return tuple(
        fault
        for fault in load_faults(INJECTORS, simulated=SIMULATED)
        if fault.id in live or fault.id not in simulated or {*fault.expect.figures} & {*OF_PROCESSES}
    )


def run(fault: Fault, pool, probe) -> Result:
    """Inject one fault; a failure in real time counts where the same bench without a fault has none at that time.

    Without `FAILURES` of those in `MOST_TRIES` tries, a fault that was never survived is not judged: it is skipped.
    """
    begun_s = time.monotonic()
    failures = 0
    for tried in range(1, MOST_TRIES + 1):
        begun_ns = time.monotonic_ns()
        result = _once(fault, pool)
        result.tries, result.lasted_s = tried, time.monotonic() - begun_s
        if not result.problems or fault.injector in IN_PROCESS:
            return result
        result.unfit = (
            _standstill(result, probe, begun_ns)
            or _slow_start_without_a_fault(result)
            or _failures_without_a_fault(pool)
        )
        failures += not result.unfit
        if failures == FAILURES:
            return result
    result.skipped = f"{NOT_JUDGED}, {result.unfit or 'a failure in one of the tries'}: {'; '.join(result.problems)}"
    result.problems = []
    return result


def _standstill(result: Result, probe, begun_ns: int) -> str:
    figures = {} if result.observed is None else result.observed.figures
    stills = [probe.worst_ms(begun_ns) if probe else 0.0]
    stills += [figures[name] for name, most_ms in EXCESS_DELAY.items() if figures.get(name, 0.0) > most_ms]
    return f"the machine stood still for {max(stills):.1f} ms" if max(stills) > 0.0 else ""


def _slow_start_without_a_fault(result: Result) -> str:
    """Where the service takes too long to start after an end in order too."""
    figures = {} if result.observed is None else result.observed.figures
    usual_ms = figures.get("usual_ready_ms", 0.0)
    return f"a start takes {usual_ms:.0f} ms without a fault too" if usual_ms > READY_WITHIN_MS else ""


def _failures_without_a_fault(pool) -> str:
    """What goes wrong on the usual bench while nothing is injected; empty where nothing does."""
    observed = Observation()
    try:
        bench = pool.bench()
        bench.arm()
        watch = running_faults.Watch(bench)
        watch.until(("RUNNING",), CONTROL_S, 0.0)
        watch.finish(observed)
    except Exception as error:  # noqa: BLE001  # the bench could not be used at all
        pool.drop()
        return f"the bench fails without a fault too: {str(error)[:100]}"
    failed = observed.figures["failed"]
    if failed or observed.state != "RUNNING":
        return f"{failed:.0f} exchanges fail without a fault too, {observed.state} after {CONTROL_S:g} s"
    return ""


def _once(fault: Fault, pool) -> Result:
    try:
        observed = INJECTORS[fault.injector](pool, fault, **fault.parameters)
    except InjectionUnavailableError as reason:
        return Result(fault, None, [], str(reason))
    except Exception as error:  # noqa: BLE001  # any error of the injector fails this fault
        if pool is not None:
            pool.drop()  # the state of the benches is unknown
        where = traceback.extract_tb(error.__traceback__)[-1]
        return Result(fault, None, [f"{type(error).__name__}: {str(error)[:300]} ({where.name}, line {where.lineno})"])
    return Result(fault, observed, observed.deviations(fault))


def header() -> str:
    """Names of the columns."""
    return COLUMNS.format(**{name: name for name in FIELDS})


def summary(results: list[Result]) -> str:
    """Skipped faults, replaced expectations, armings, envelope violations and the count of survived faults."""
    lines = [f"skipped {result.fault.id}: {result.skipped}" for result in results if result.skipped]
    lines += [f"instead {one.fault.id}: {' '.join(one.fault.instead.split())}" for one in results if one.fault.instead]
    run_ = [result for result in results if not result.skipped]
    armings = sum(result.observed.armings for result in run_ if result.observed is not None)
    judged = [result for result in run_ if result.observed is not None and result.observed.wrong is not None]
    outside = sum(bool(result.observed.wrong) for result in judged)
    lines.append(f"re-arms: {armings}; output outside its envelope: {outside} of the {len(judged)} where it was judged")
    lines.append(f"{sum(result.survived for result in run_)} of {len(run_)} faults survived")
    return "\n".join(lines)
