"""`python -m tests.simulation`: run histories, and print what was violated."""

import argparse
import resource
import subprocess
import sys
import time

from tests.simulation.holes import HOLES, put_back
from tests.simulation.plan import draw, draw_contest

FOUND = "found: "  # begin of the line with the rest of a row


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="number of histories")
    parser.add_argument("--first", type=int, default=1, metavar="S", help="first seed")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="T", help="virtual duration of a history")
    parser.add_argument("--seed", type=int, metavar="S", help="one history")
    parser.add_argument("--trace", action="store_true", help="print the history")
    parser.add_argument("--hash", action="store_true", help="print the hash of each history")
    parser.add_argument("--shrink", action="store_true", help="repeat a violation with fewer events")
    parser.add_argument("--contest", action="store_true", help="two clients, two verbs and faults, in each history")
    parser.add_argument("--hole", choices=HOLES, help="run with a hole of the past, until a violation")
    parser.add_argument("--holes", action="store_true", help="every hole of the past in turn")
    wanted = parser.parse_args()
    if wanted.holes:
        return each_hole(wanted)
    if wanted.hole:
        put_back(HOLES[wanted.hole])
    from tests.simulation.runs import run, warm_up
    from tests.simulation.shrinking import shrink

    seeds = range(wanted.first, wanted.first + wanted.seeds) if wanted.seed is None else [wanted.seed]
    warm_up()
    begun_s, virtual_s, used_s, failed = time.monotonic(), 0.0, 0.0, 0
    transitions = 0
    for seed in seeds:
        plan = (draw_contest if wanted.contest else draw)(seed, wanted.seconds)
        result = run(plan, print if wanted.trace else None)
        transitions += result.observed.get("transitions", 0)
        virtual_s, used_s = virtual_s + result.seconds, used_s + result.real_s
        if wanted.hash:
            print(f"{seed} {result.digest}")
        if result.violations:
            failed += 1
            report(plan, result)
            shrunk = shrink(plan, result) if wanted.shrink else None
            if wanted.hole:
                report_hole(plan, result, shrunk)
                break
    real_s = time.monotonic() - begun_s
    print(
        f"{len(seeds)} histories, {transitions} transitions, {virtual_s:.0f} virtual seconds in {real_s:.1f} s, "
        f"{virtual_s / max(used_s, 1e-9):.1f} virtual seconds a processor second, {failed} with violations"
    )
    return 1 if failed else 0


def each_hole(wanted):
    """Put every hole back, one by one, and print where it is found; the number of those that are not.

    With `--shrink`, also with how few events it is found again.
    """
    missed = 0
    print("| hole | seed | violation | at [s] | events | shrunk | length [s] | shrunk | processor [s] |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, hole in HOLES.items():
        options = ["--seeds", str(wanted.seeds), "--first", str(wanted.first), "--seconds", str(wanted.seconds)]
        options += [f"--{name}" for name in ("shrink", "contest") if getattr(wanted, name)]
        command = [sys.executable, "-m", "tests.simulation", "--hole", name, *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found = [line.removeprefix(FOUND) for line in done.stdout.splitlines() if line.startswith(FOUND)]
        missed += not found
        print(f"| {name} ({hole.source}) | {found[0] if found else f'not in {wanted.seeds} | | | | | | |'}")
        sys.stdout.flush()
    print(f"{len(HOLES) - missed} of {len(HOLES)} found")
    return int(missed > 0)


def report_hole(plan, result, shrunk):
    """Print the rest of the row of a hole."""
    kind, time_s, _ = result.violations[0]
    events, seconds = ("", "") if shrunk is None else (len(shrunk.events), f"{shrunk.seconds:.1f}")
    cells = (plan.seed, kind, f"{time_s:.2f}", len(plan.events), events, f"{plan.seconds:.1f}", seconds)
    print(FOUND + " | ".join(map(str, (*cells, f"{time.process_time() + children_s():.0f}"))) + " |")


def children_s():
    """Processor time of the histories that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def report(plan, result):
    """Print the violations of a history, and the command that repeats it."""
    for kind, time_s, text in result.violations:
        print(f"seed {plan.seed}: {kind} at {time_s:.4f} s: {text}", flush=True)
    print(f"  python -m tests.simulation --seconds {plan.seconds:g} --seed {plan.seed} --trace")


if __name__ == "__main__":
    sys.exit(main())
