"""What is understood of files that spreadsheets, instruments and libraries write, and what is refused.

python -m tests.studies messy_files
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from piezod.errors import PiezodError
from piezod.recording import Recording, TextOptions, read_recording
from piezod.recording.formats.repairs import repair_notes
from tests.benches.instrument_files import instrument_files
from tests.benches.messy_files import Form, forms, questions, recorded
from tests.benches.world_files import DT_S, F_N, U_V, WorldFile, world_files


def add_options(parser: argparse.ArgumentParser) -> None:
    """The study has no options."""
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Read every file; print a line each, and the counts."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, answer, words, took_s in _answers(Path(folder)):
            counts[answer] += 1
            print(f"{answer:8} {took_s:5.2f} s  {name}: {words}", flush=True)
    print(f"{counts.total()} files: " + ", ".join(f"{count} {answer}" for answer, count in counts.most_common()))
    print("WRONG: 0" if not counts["WRONG"] else f"WRONG: {counts['WRONG']}")


def _answers(folder: Path) -> Iterator[tuple[str, str, str, float]]:
    """Name of each file; `right`, `asked`, `refused` or `WRONG`; words of the program; processor time [s]."""
    for form in forms():
        path = folder / f"rec{form.suffix}"
        path.write_bytes(form.content)
        yield form.name, *_answer(path, form.options, lambda read, form=form: _is_form(form, read))
    for question in questions():
        path = folder / "rec.csv"
        path.write_text(question.content, encoding="utf-8")
        yield question.name, *_answer(path, TextOptions(), lambda _: False)
    for file in (*world_files(), *instrument_files()):
        if file.is_possible:
            yield file.name, *_answer(file.make(folder), file.options, lambda read, file=file: _is_file(file, read))


def _answer(path: Path, options: TextOptions, is_right: Callable[[Recording], bool]) -> tuple[str, str, float]:
    begun_s = time.process_time()
    try:
        read = read_recording(path, options)
    except PiezodError as error:
        words = str(error).removeprefix(f"{path}: ")
        answer = "WRONG" if "\n" in words else "asked" if "--" in words else "refused"
        return answer, words, time.process_time() - begun_s
    took_s = time.process_time() - begun_s
    words = "; ".join(filter(None, [read.metadata.get("understood", ""), *repair_notes(read.metadata)]))
    return "right" if is_right(read) else "WRONG", words or "as written here", took_s


def _is_form(form: Form, read: Recording) -> bool:
    return all(
        np.allclose(read.channels[name], factor * wanted, atol=0.51 * 10.0**-form.decimals, rtol=1e-9)
        for (name, factor), wanted in zip(form.channels.items(), recorded()[1:], strict=True)
    )


def _is_file(file: WorldFile, read: Recording) -> bool:
    """Whether the numbers are those that were written; a cell that is no number is missing and reported."""
    if file.refused or read.time_s.size != file.rows or not np.allclose(np.diff(read.time_s), DT_S, atol=1e-6):
        return False
    voltage_V = U_V if file.wanted_V is None else file.wanted_V
    for name, wanted, factor in ((file.u, voltage_V, file.factors[0]), (file.f, F_N, file.factors[1])):
        if name == file.lacks:
            if name in read.channels:
                return False
            continue
        values = read.channels[name]
        there = np.isfinite(values)
        if not np.allclose(values[there], factor * wanted[: file.rows][there], atol=factor * file.atol):
            return False
    return True
