"""Studies of diagnosis, compensation and recorder with known truth; each takes minutes.

    python -m tests.studies scenarios [--only NAME,NAME] [--jobs N] [--short] [--json FILE] [--folder DIR]
    python -m tests.studies overlay [--bench NAME,NAME] [--strength X] [and as above]
    python -m tests.studies peers STUDY VERDICTS [--only CASE,CASE] [--cases N] [--json FILE] [--folder DIR]

`piezod blind` measures the diagnosis on concealed cases; `peers` compares it with other methods. The other studies
record the emulated bench over its link, or lay an effect over recordings of a real bench.
"""
