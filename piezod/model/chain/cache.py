"""The last few results of a computation, kept for who asks again."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Key = tuple[object, ...]
Value = TypeVar("Value")


class Kept(Generic[Value]):
    """The last few results of a computation by what they depend on; threads may share it."""

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, threading.Lock()
        self._known: dict[Key, Value] = {}

    def get(self, key: Key, compute: Callable[[], Value]) -> Value:
        """What was computed for a key, computed now where it is not known (any more)."""
        known = self._known.get(key)
        if known is None:
            known = compute()
            with self._lock:
                while len(self._known) >= self._most:
                    del self._known[next(iter(self._known))]
                self._known[key] = known
        return known

    def forget(self) -> None:
        """Let go of everything."""
        with self._lock:
            self._known.clear()
