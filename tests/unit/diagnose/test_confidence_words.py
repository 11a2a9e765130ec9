"""One scale of words for confidence: pages, terminal, notes."""

from dataclasses import replace

import pytest

from piezod.diagnose.verdict.low_confidence import rejection_notes
from piezod.diagnose.verdict.words import confidence_words
from tests.unit.report.example_diagnosis import DELAY, STEP, diagnosis


@pytest.mark.parametrize(
    ("confidence", "words"),
    [(0.99, "99 % (high)"), (0.9, "90 % (high)"), (0.6, "60 % (medium)"), (0.59, "59 % (low)"), (0.0, "0 % (low)")],
)
def test_a_confidence_is_a_percentage_with_its_level(confidence, words):
    assert confidence_words(confidence) == words


def test_a_note_on_a_rejected_effect_has_the_same_scale_and_no_rate():
    doubted = replace(DELAY, confidence=0.41, before=0.5, after=0.4, p=0.1, q=0.3)
    findings = diagnosis(effects=(STEP, doubted)).findings
    (note,) = rejection_notes(findings, [doubted.name])
    assert note.endswith("but is not named: confidence 41 % (low)")
    assert "rate" not in note
