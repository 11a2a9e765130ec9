"""Files that are written in a thread: nobody waits, the newest content wins."""

import threading

from piezod.daemon.newest_writer import NewestWriter


def test_of_the_contents_that_wait_for_a_file_only_the_newest_is_written():
    writer, goes_on, written = NewestWriter(), threading.Event(), []
    writer.write("a", lambda: goes_on.wait(30.0) and written.append("first"))
    for content in range(5):
        writer.write("b", lambda content=content: written.append(content))
    assert not writer.flush(0.01)
    goes_on.set()
    assert writer.flush(30.0)
    assert written == ["first", 4]


def test_a_writer_at_rest_writes_again():
    writer, written = NewestWriter(), []
    for content in range(3):
        writer.write("a", lambda content=content: written.append(content))
        assert writer.flush(30.0)
    assert written == [0, 1, 2]
