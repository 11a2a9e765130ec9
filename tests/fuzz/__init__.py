"""Parsers under fire: frames, lines, configurations, models, recordings and control messages.

    python -m tests.fuzz [--frames N] [--configurations N] [--models N] [--recordings N] [--messages N] [--seed N]

Every case runs in a child process that may crash, hang or swell, and is watched: only a `PiezodError` of one printable
line may leave a parser, and what a parser accepts is compared with what the standard, read a second time, says. With
atheris (`pip install 'piezod-bench[fuzz]'`) the cases are guided by coverage, without it they are mutated at random
from a seed. An input that fails is kept, and printed with the command that repeats it.
"""
