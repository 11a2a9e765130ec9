"""Wrong calls of the Python interface are answered by one line of piezod, right ones are done."""

import pytest

from tests.studies.api_calls import answered, calls


@pytest.fixture(scope="module")
def every_call(tmp_path_factory):
    return calls(tmp_path_factory.mktemp("calls"))


def test_every_wrong_call_is_told_in_one_line(every_call):
    answers = {words: answered(call, is_right=False) for words, call, is_right in every_call if not is_right}
    assert {words: answer for words, answer in answers.items() if answer[0] != "told"} == {}
    assert len(answers) >= 55


def test_every_right_call_without_an_identification_is_done(every_call):
    right = [(words, call) for words, call, is_right in every_call if is_right and "identify(" not in words]
    assert {words: kind for words, call in right if (kind := answered(call, is_right=True)[0]) != "done"} == {}
    assert len(right) >= 14
