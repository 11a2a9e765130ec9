"""Each promise of a page has the test that fails when it is broken (`tests/claims.yaml`)."""

import ast
import tomllib

import pytest
import yaml

from tests.house import ROOT

PAGES = yaml.safe_load((ROOT / "tests" / "claims.yaml").read_text(encoding="utf-8"))
CLAIMS = [(page, words, proof) for page, claims in PAGES.items() for words, proof in claims.items()]
BY_COMMAND = {"lint-imports": "importlinter"}  # section of pyproject.toml with the rules that the command checks
LEAST = 25  # claims with a proof; a page that promises more gets more of them


def plain(text):
    return " ".join(text.split())


def names_of(path):
    """Names that pytest collects from a file: functions and classes at its top, assigned ones too."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


@pytest.mark.parametrize(("page", "words", "proof"), CLAIMS)
def test_a_claim_stands_on_its_page_and_has_a_test(page, words, proof):
    assert plain(words) in plain((ROOT / page).read_text(encoding="utf-8"))
    if proof in BY_COMMAND:
        rules = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
        assert rules[BY_COMMAND[proof]]["contracts"]
    else:
        file, name = proof.split("::")
        assert name in names_of(ROOT / "tests" / file)


def test_the_first_pages_have_their_claims_proven():
    assert {"README.md", "piezod/README.md", "systemd/README.md", "piezod/diagnose/README.md"} <= set(PAGES)
    assert len(CLAIMS) >= LEAST
