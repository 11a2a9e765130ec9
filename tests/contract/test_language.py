"""What is written in the packages is plain: short sentences, sources that a reader can open, the field's words."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted(path for package in ("piezod", "firmware_sim") for path in (ROOT / package).rglob("*.py"))
MOST_WORDS = 25
RIDDLES = re.compile(
    r"\b(told|taken_in|take_in|unfolded|passages|listening|lattice|wish(ed|es)?|feels?|desk|tally|apart|judg(e|ed|es|ing)|"
    r"seats?|punctual|lamp|believe[ds]?|obeys?)\b",
    re.IGNORECASE,
)
MISSING_DOCUMENTS = re.compile(r"\b(THEORY|DESIGN|STYLE|ESTIMATION|DIAGNOSIS|REALTIME|FAULTS)\b")
INTERFACE = {
    '"seat": _location(effect),',  # a key of `piezod effects --json`
    '"believed": attempt.accepted,',  # a key of the replay file
    'f"believed (confidence {finding.confidence:.2f}"',  # a note in `findings.json`
}


def docstrings(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""


def sentences(text):
    """Sentences of a docstring, without its diagrams: lines with an arrow or a table's gap of three spaces."""
    prose = "\n".join(line for line in text.split("\n") if "->" not in line and not re.search(r"\S {3,}\S", line))
    return [sentence.split() for sentence in re.split(r"(?<=[.;:])\s+|\n\s*\n|\n\s*- ", prose)]


@pytest.mark.parametrize("package", ["piezod", "firmware_sim"])
def test_no_sentence_of_a_docstring_has_more_than_25_words(package):
    long = [
        f"{path.relative_to(ROOT)}: {' '.join(words)}"
        for path in SOURCES
        if path.is_relative_to(ROOT / package)
        for text in docstrings(path)
        for words in sentences(text)
        if len(words) > MOST_WORDS
    ]
    assert long == []


@pytest.mark.parametrize("pattern", [RIDDLES, MISSING_DOCUMENTS], ids=["words", "documents"])
def test_no_source_uses_a_word_that_needs_a_second_reading_or_cites_a_document_that_is_not_there(pattern):
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in SOURCES
        for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1)
        if pattern.search(line) and line.strip() not in INTERFACE
    ]
    assert found == []
