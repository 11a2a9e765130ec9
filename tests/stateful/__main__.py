"""`python -m tests.stateful`: run sequences, and print what was done and what was violated."""

import argparse
import sys
import time

from tests.stateful.run import CHUNK, open_service, run_chunk


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.stateful", description=__doc__)
    parser.add_argument("--sequences", type=int, default=2000, metavar="N", help="how many, in all")
    parser.add_argument("--steps", type=int, default=12, metavar="N", help="steps of a sequence, at most")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help=f"of the first {CHUNK}; each more adds one")
    parser.add_argument("--seconds", type=float, default=float("inf"), metavar="S", help="end after this time")
    wanted = parser.parse_args()
    begun_s, seed, failures = time.monotonic(), wanted.seed, []
    with open_service() as service:
        while service.sequences < wanted.sequences and time.monotonic() - begun_s < wanted.seconds and not failures:
            failures = run_chunk(service, min(CHUNK, wanted.sequences - service.sequences), wanted.steps, seed)
            seed += 1
            print(
                f"{service.sequences} sequences, {sum(service.done.values())} steps, "
                f"{time.monotonic() - begun_s:.0f} s, next seed {seed}",
                file=sys.stderr,
            )
        for name, count in sorted(service.done.items()):
            print(f"{count:7d}  {name}")
        print(
            f"{service.sequences} sequences, {sum(service.done.values())} steps, {len(failures)} violations, "
            f"{service.judge.not_judged} excesses of the slew while this machine stood still, "
            f"{time.monotonic() - begun_s:.0f} s"
        )
    for message, steps in failures:
        print(f"violation with seed {seed - 1}: {message}\n  " + "\n  ".join(steps))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
