"""Other methods on the cases of a concealed study, in the same table as `piezod`.

    python -m tests.studies peers STUDY VERDICTS [--only case_0001,...] [--cases N] [--folder DIR] [--json FILE]

`STUDY` was made by `piezod blind make`, `VERDICTS` by `piezod blind run`. A peer gets the same
data as `piezod`, and the simulation of the identified model as a further column. It runs in a separate process and
environment. The truth is read after all predictions are written.

    given        what a peer may see of a case
    exchange     how it reads that and answers; copied beside it
    discrepancy  PySINDy as a model of what the given model leaves out
    narx         SysIdentPy's FROLS
    lagged       ridge regression on lagged columns, for scale
    environments virtual environments with pinned packages
    run          a peer on a case, in its process
    figures      the table
"""
