"""Fuzzing of the parsers: frames, lines, configurations, models, recordings and control messages.

    python -m tests.fuzz [--frames N] [--configurations N] [--models N] [--recordings N] [--messages N] [--seed N]

Every case runs in a child process, which is watched for crashes, hangs and memory growth. A parser may raise only a
`PiezodError` of one printable line. What a parser accepts is compared with a second reader of the standard. With
atheris (`pip install 'piezod-bench[fuzz]'`) the cases are guided by coverage, without it they are mutated at random
from a seed. An input that fails is stored, and printed with the command that repeats it.
"""
