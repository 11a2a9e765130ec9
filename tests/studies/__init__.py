"""How often the diagnosis is right where the truth is known: studies that take minutes, as commands.

    python -m tests.studies scenarios [--only NAME,NAME] [--jobs N] [--short] [--json FILE] [--folder DIR]
    python -m tests.studies overlay [--bench NAME,NAME] [--strength X] [and as above]
    python -m tests.studies peers STUDY VERDICTS [--only CASE,CASE] [--cases N] [--json FILE] [--folder DIR]

`piezod blind` measures the same on concealed cases; `peers` puts other methods beside it. In the others the bench is
the emulated one, recorded over its link, or a real one, whose recordings have an effect laid over them.
"""
