"""`python -m tests.simulation`: run histories, and print what was violated."""

import argparse
import sys
import time

from tests.simulation.plan import draw
from tests.simulation.runs import run, warm_up


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="number of histories")
    parser.add_argument("--first", type=int, default=1, metavar="S", help="first seed")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="T", help="virtual duration of a history")
    parser.add_argument("--seed", type=int, metavar="S", help="one history")
    parser.add_argument("--trace", action="store_true", help="print the history")
    parser.add_argument("--hash", action="store_true", help="print the hash of each history")
    parser.add_argument("--shrink", action="store_true", help="repeat a violation with fewer events")
    wanted = parser.parse_args()
    seeds = range(wanted.first, wanted.first + wanted.seeds) if wanted.seed is None else [wanted.seed]
    warm_up()
    begun_s, virtual_s, used_s, failed = time.monotonic(), 0.0, 0.0, 0
    for seed in seeds:
        plan = draw(seed, wanted.seconds)
        result = run(plan, print if wanted.trace else None)
        virtual_s, used_s = virtual_s + result.seconds, used_s + result.real_s
        if wanted.hash:
            print(f"{seed} {result.digest}")
        if result.violations:
            failed += 1
            report(plan, result)
            if wanted.shrink:
                from tests.simulation.shrinking import shrink

                shrink(plan, result)
    real_s = time.monotonic() - begun_s
    print(
        f"{len(seeds)} histories, {virtual_s:.0f} virtual seconds in {real_s:.1f} s, "
        f"{virtual_s / max(used_s, 1e-9):.1f} virtual seconds a processor second, {failed} with violations"
    )
    return 1 if failed else 0


def report(plan, result):
    """Print the violations of a history, and the command that repeats it."""
    for kind, time_s, text in result.violations:
        print(f"seed {plan.seed}: {kind} at {time_s:.4f} s: {text}")
    print(f"  python -m tests.simulation --seconds {plan.seconds:g} --seed {plan.seed} --trace")


if __name__ == "__main__":
    sys.exit(main())
