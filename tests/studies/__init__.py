"""How often the diagnosis is right where the truth is known: studies that take minutes, as commands.

    python -m tests.studies scenarios [--only NAME,NAME] [--jobs N] [--short] [--json FILE] [--folder DIR]

`piezod blind` measures the same on concealed cases. Here the bench is the emulated one, recorded over its link.
"""
