"""How fast it is, every figure beside what the machine allows.

    python -m tests.benchmarks [NAME...] [--json FILE] [--quick]

Absolute times move with the machine; ratios within one run hold. So every figure stands beside a limit that is measured
in the same run, the two alternating round by round, and both are medians over the rounds. No test asserts any of it.
"""
