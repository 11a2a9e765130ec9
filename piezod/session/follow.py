"""Run a session from its start to its end and collect its history."""

import signal
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from piezod.runtime import signals
from piezod.session.history import History
from piezod.session.session import Session

OnRows = Callable[[NDArray[np.void]], None]
"""Called about ten times per second with the new rows of the ring log, shape (N,)."""


def follow_session(session: Session, on_rows: OnRows) -> History:
    """Start a session, collect every row until its end, and close it.

    Ctrl-C requests a ramp down; the rows of the ramp are still collected.

    Parameters
    ----------
    session
        Session that has not been started.
    on_rows
        Called with every part of new rows.

    Raises
    ------
    PiezodError
        The bench could not be connected, or the session failed.
    """
    history = History()
    before = signals.handle(signal.SIGINT, lambda *_: session.stop())
    try:
        session.start()
        for rows in session.follow():
            history.add(rows)
            on_rows(rows)
    finally:
        session.close()
        signals.handle(signal.SIGINT, before)
    return history
