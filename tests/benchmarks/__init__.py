"""Benchmarks; each figure stands beside the limit of the machine.

    python -m tests.benchmarks [NAME...] [--json FILE] [--quick]

Absolute times move with the machine; ratios within one run hold. So every figure stands beside a limit that is measured
in the same run, the two alternating round by round, and both are medians over the rounds. No test asserts any of it.
"""
