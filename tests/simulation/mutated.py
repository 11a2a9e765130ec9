"""Runs with a mutation: as a plugin of pytest, or as a program that runs rows and seeds until one finds it."""

import sys

from tests.simulation.mutations import QUICK_ROWS, SECONDS, SEEDS, apply_named

apply_named()


def main():
    from tests.simulation.plan import draw
    from tests.simulation.rows import phases, rows, run_row
    from tests.simulation.runs import run, warm_up

    warm_up()
    every = rows()
    for name in QUICK_ROWS:
        fault = every[name]
        bad, _ = run_row(fault, phases(fault)[0])
        if bad:
            print(f"row {name}: {bad[0]}")
            return 1
    for seed in range(1, SEEDS + 1):
        if found := run(draw(seed, SECONDS)).violations:
            print(f"seed {seed}: {found[0][0]}: {found[0][2]}")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
