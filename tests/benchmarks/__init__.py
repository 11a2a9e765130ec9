"""Benchmarks; each figure stands beside the limit of the machine.

    python -m tests.benchmarks [NAME...] [--json FILE] [--quick]

Absolute times vary with the machine; ratios within one run are stable. So each figure stands beside a limit measured in
the same run. Figure and limit alternate round by round, and both are medians over the rounds. No test asserts a time.
"""
