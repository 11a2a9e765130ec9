"""Other methods on the cases of a concealed study, in the same table as `piezod`.

    python -m tests.studies peers STUDY VERDICTS [--only case_0001,...] [--cases N] [--folder DIR] [--json FILE]

`STUDY` was made by `piezod blind make`, `VERDICTS` by `piezod blind run`. A peer gets what `piezod` gets, and the
simulation of the identified model as one more column; it runs in a process and an environment of its own. The truth is
opened when all predictions are written.

    given        what a peer may see of a case
    exchange     how it reads that and answers; copied beside it
    discrepancy  PySINDy as a model of what the given model leaves out
    narx         SysIdentPy's FROLS
    lagged       ridge regression on lagged columns, for scale
    environments virtual environments with pinned packages
    run          a peer on a case, in its process
    figures      the table
"""
