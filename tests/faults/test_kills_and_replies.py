"""After SIGKILL or SIGSTOP the watchdog makes the device safe; the links accept no false reply."""

import pytest

from tests.faults import kills, replies
from tests.faults.forgeries import KINDS

TIMES = 3


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGKILL", "SIGSTOP"])
def test_the_device_is_safe_within_its_watchdog_and_a_tick(how):
    found = kills.kills(how, TIMES)
    print(kills.HEADER, kills.line(found), sep="\n")
    assert found.times == TIMES
    assert not found.problems()


@pytest.mark.parametrize("kind", KINDS)
def test_link_accepts_no_stale_or_false_reply(kind):
    rows = list(replies.rows(30, kinds=(kind,)))
    assert rows
    for row in rows:
        assert row.accepted == 0, row.text()
        assert sum(row.refused_as.values()) == row.sent == 30, row.text()
