"""Which names are left out again: the least believed one at a time, and none that carries most of the error."""

from types import SimpleNamespace

import pytest

from piezod.diagnose.diagnosis import _doubtful


def doubted(*effects, before=2.0, after=1.0):
    """Of effects given as name, confidence, error without and with it."""
    names = [name for name, *_ in effects]
    found = [SimpleNamespace(name=n, confidence=c, before=b, after=a) for n, c, b, a in effects]
    result = SimpleNamespace(names=names, found=SimpleNamespace(effects=names))
    return _doubtful(result, SimpleNamespace(effects=found, before=before, after=after))


def test_of_two_that_are_believed_too_little_the_lesser_goes_first():
    effects = ("creep", 0.55, 1.2, 1.0), ("friction", 0.3, 1.1, 1.0), ("resonance", 0.9, 1.5, 1.0)
    assert doubted(*effects) == ["friction"]


def test_what_stands_alone_and_leaves_much_goes_too():
    assert doubted(("creep", 0.55, 1.2, 1.0)) == ["creep"]


@pytest.mark.parametrize("others", [(), (("resonance", 0.9, 1.5, 1.0),)], ids=["alone", "beside a surer one"])
def test_what_halves_the_error_stays(others):
    assert doubted(("creep", 0.4, 2.1, 1.0), *others) == []
    assert doubted(("creep", 0.4, 1.9, 1.0), *others) == ["creep"]


def test_all_go_where_the_given_model_says_it_as_well():
    assert doubted(("creep", 0.9, 3.0, 1.0), ("friction", 0.9, 2.0, 1.0), before=1.0) == ["creep", "friction"]
