"""Names and sentences of each room are plain: few of the words and phrases that need a second reading.

Each room has two figures: puzzling names per 100 lines of code, puzzling phrases per 1,000 words of docstrings and
comments. A limit only falls: lower it when a room is rewritten.
"""

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# name: what a thing went through, where it stands, or a verb of a person, in place of the thing itself
NAME_WORDS = set(
    re.findall(
        r"\w+",
        """alike anew apart again asked attend attends believe believed beside courses desk doubt doubted feel feels
        finalists found gone heard hears here idea ideas its kept lamp lattice left leaves listen listening mine mostly
        much needed needless obey obeys one ones passages punctual said says seat settled sharp shaken suited take taken
        tally tell tells theirs there things together told unfolded usual whole wish wished""",
    )
)
PHRASES = [
    re.compile(pattern, re.IGNORECASE | re.MULTILINE)
    for pattern in (
        r"\bwhat(?:ever)?\b",
        r"\bbelieve[sd]?\b|\bdoubt(?:s|ed)?\b|\btells?\b|\btold\b|\bsays?\b|\bsaid\b|\bspeaks?\b|\bpromises?\b|\bheard\b",
        r"\b(?:does|do|did) not ask\b|\basked\b|\bsure\b|\bnobody\b|\bno noise\b",
        r"\bthe same\b|\bthe ones?\b|\bones? (?:that|which)\b|\b(?:those|that) of\b|\bthose (?:that|which|with|it)\b",
        r"\bnothing (?:is|else|of|to)\b|\b(?:of|by|with) (?:it|them|these)[.;]|\bbetween them\b|\bbeside\b|\banew\b",
        r"\bcomes? by\b|\bleft (?:out|over|of)\b|\bfirst of all\b|\bfor ever\b|\bmuch (?:is|was) left\b",
        r"^\s+(?:Of|As it|As they|With which|By which)\b[^,:]{0,50}\.$",  # a fragment as the text of a parameter
    )
]

LIMITS = {  # room: names per 100 lines of code, phrases per 1,000 words
    "firmware_sim": (1.0, 2.0),
    "firmware_sim/concealed": (1.0, 4.0),
    "firmware_sim/firmware": (0.5, 1.0),
    "firmware_sim/physics": (0.5, 1.0),
    "firmware_sim/wire": (0.5, 1.0),
    "piezod": (1.0, 8.0),
    "piezod/api": (1.0, 1.5),
    "piezod/blind": (0.5, 1.0),
    "piezod/bridge": (1.5, 6.0),
    "piezod/cli": (0.5, 2.5),
    "piezod/commissioning": (0.5, 2.0),
    "piezod/config": (0.5, 1.0),
    "piezod/control": (1.5, 8.0),
    "piezod/daemon": (1.0, 7.0),
    "piezod/diagnose": (1.0, 4.0),
    "piezod/effects": (1.0, 4.0),
    "piezod/estimation": (0.5, 1.5),
    "piezod/history": (0.5, 1.5),
    "piezod/identify": (0.5, 1.5),
    "piezod/model": (1.0, 5.0),
    "piezod/operators": (1.0, 1.5),
    "piezod/recorder": (0.5, 1.0),
    "piezod/recording": (0.5, 1.0),
    "piezod/report": (0.5, 1.0),
    "piezod/runtime": (0.5, 1.0),
    "piezod/session": (0.5, 1.0),
    "piezod/tasks": (0.5, 1.0),
    "piezod/transport": (1.0, 3.0),
}


def room_of(path):
    parts = path.relative_to(ROOT).parts
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0]


ROOMS = {}
for _package in ("firmware_sim", "piezod"):
    for _path in sorted((ROOT / _package).rglob("*.py")):
        ROOMS.setdefault(room_of(_path), []).append(_path)


def nodes(root):
    """All nodes of a tree; three times as fast as `ast.walk`."""
    collected = [root]
    for node in collected:
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                collected.append(value)
            elif isinstance(value, list):
                collected.extend(child for child in value if isinstance(child, ast.AST))
    return collected


def name_of(node):
    """Name that a node defines, or an empty text."""
    if isinstance(node, ast.Name | ast.Attribute):
        return (node.id if isinstance(node, ast.Name) else node.attr) if isinstance(node.ctx, ast.Store) else ""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return node.name
    return node.arg if isinstance(node, ast.arg) else ""


def is_text(node):
    """Whether a statement is a string that stands alone: a docstring, or the description of a constant."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def words_of(name):
    return {word.lower() for word in re.split(r"_+|(?<=[a-z])(?=[A-Z])", name)}


def puzzles(source):
    """Puzzling names and phrases of a source, and its lines of code and words of prose."""
    tree = nodes(ast.parse(source))
    texts = [node for node in tree if is_text(node)]
    in_texts = {number for node in texts for number in range(node.lineno, node.end_lineno + 1)}
    code = [
        line
        for number, line in enumerate(source.splitlines(), 1)
        if number not in in_texts and line.strip() and not line.strip().startswith("#")
    ]
    prose = [*(node.value.value for node in texts), *re.findall(r"(?:^|\s)# (.*)$", source, re.MULTILINE)]
    names = [name for name in map(name_of, tree) if NAME_WORDS & words_of(name)]
    phrases = [match.group().strip() for text in prose for pattern in PHRASES for match in pattern.finditer(text)]
    return Counter(names), Counter(phrases), len(code), sum(len(text.split()) for text in prose)


def worst(counter):
    return ", ".join(f"{name} {count}" for name, count in counter.most_common(8))


def figures(sources):
    """Names per 100 lines and phrases per 1,000 words of several sources, with the most frequent of each."""
    parts = [puzzles(source) for source in sources]
    names, phrases = (sum((part[k] for part in parts), Counter()) for k in (0, 1))
    lines, words = (max(sum(part[k] for part in parts), 1) for k in (2, 3))
    return 100 * names.total() / lines, 1000 * phrases.total() / words, worst(names), worst(phrases)


def excess(room, limits, measured):
    """Lines for the figures of a room above their limits."""
    units = ("names per 100 lines of code", "phrases per 1,000 words")
    return [
        f"{room}: {figure:.1f} puzzling {unit}, may be {limit:g}: {most}; name the thing itself"
        for figure, limit, unit, most in zip(measured[:2], limits, units, measured[2:], strict=True)
        if figure > limit
    ]


RIDDLE = '''
def as_told(one, asked):
    """What a name is believed by is what it explains.

    Parameters
    ----------
    asked
        Of the file.
    """
    left = one - asked  # the same with those that are left out
    return left
'''
PLAIN = '''
def difference(measured_N, simulated_N):
    """Measured minus simulated force, shape (N,) [N]."""
    return measured_N - simulated_N  # the tare stays
'''


def test_a_riddle_exceeds_the_limits_and_is_named():
    names, phrases, lines, words = puzzles(RIDDLE)
    assert names == {"as_told": 1, "one": 1, "asked": 1, "left": 1}
    assert set(phrases) == {"What", "what", "believed", "asked", "Of the file.", "the same", "those that", "left out"}
    assert (lines, words) == (3, 24)
    reported = excess("piezod/riddles", (1.0, 5.0), figures([RIDDLE]))
    assert len(reported) == 2
    assert all("piezod/riddles" in line for line in reported)
    assert "133.3" in reported[0]
    assert "as_told 1" in reported[0]


def test_plain_words_have_no_figure():
    assert figures([PLAIN])[:2] == (0.0, 0.0)


def test_a_name_is_read_word_by_word():
    names, _, _, _ = puzzles("stone = money = None\nclass LeastBelieved: pass")
    assert names == {"LeastBelieved": 1}


def test_every_room_has_limits():
    assert set(LIMITS) == set(ROOMS), "give a new room its limits, remove those of a room that is gone"


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_a_room_stays_within_its_limits(room):
    assert room in LIMITS, f"{room} has no limits in {Path(__file__).name}"
    assert excess(room, LIMITS[room], figures([path.read_text(encoding="utf-8") for path in ROOMS[room]])) == []
