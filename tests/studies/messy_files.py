"""What is understood of text that spreadsheets and instruments write, and what is refused.

python -m tests.studies messy_files
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from piezod.errors import PiezodError
from piezod.recording import read_recording
from tests.benches.messy_files import forms, questions, recorded


def add_options(parser: argparse.ArgumentParser) -> None:
    """The study has no options."""
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Read every form and every open question; print a line each."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for form in forms():
            path = Path(folder) / f"rec{form.suffix}"
            path.write_bytes(form.content)
            read = read_recording(path, form.options)
            right = all(
                np.allclose(read.channels[name], factor * wanted, atol=0.51 * 10.0**-form.decimals, rtol=1e-9)
                for (name, factor), wanted in zip(form.channels.items(), recorded()[1:], strict=True)
            )
            wrong += not right
            print(
                f"{'right' if right else 'WRONG':8} {form.name}: {read.metadata.get('understood', 'as written here')}"
            )
            print(f"         {form.source}")
        for question in questions():
            path = Path(folder) / "rec.csv"
            path.write_text(question.content, encoding="utf-8")
            try:
                read_recording(path)
            except PiezodError as error:
                print(f"refused  {question.name}: {str(error).removeprefix(f'{path}: ')}")
            else:
                wrong += 1
                print(f"WRONG    {question.name}: was read")
    print(f"{len(forms())} forms and {len(questions())} questions, {wrong} wrong")
