"""Fewer events and a shorter time that still give the same violation."""

from dataclasses import replace

from tests.simulation.runs import run

AFTER_S = 4.0  # from the last event to the end: the longest time until a violation is seen


def shrink(plan, result, most_runs=80):
    """Print the smallest plan that was found with the first violation of `result`; returns it.

    Groups of events are left out, then single ones (Zeller and Hildebrandt 2002, delta debugging).
    """
    kind = result.violations[0][0]
    runs = 0

    def fails(tried):
        nonlocal runs
        runs += 1
        return kind in [found for found, *_ in run(tried).violations]

    size = max(1, len(plan.events) // 2)
    while size and runs < most_runs:
        at = 0
        while at < len(plan.events) and runs < most_runs:
            tried = plan.without(range(at, at + size))
            if fails(tried):
                plan = tried
            else:
                at += size
        size //= 2
    if plan.events:
        shorter = replace(plan, seconds=min(plan.seconds, plan.events[-1].time_s + AFTER_S))
        plan = shorter if fails(shorter) else plan
    print(f"  {kind} remains with {len(plan.events)} events in {plan.seconds:.1f} s, after {runs} runs:")
    for event in plan.events:
        print(f"    {event}")
    return plan
