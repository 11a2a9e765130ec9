"""Cache of the last results of a computation."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Key = tuple[object, ...]
Value = TypeVar("Value")


class Cache(Generic[Value]):
    """Last results of a computation, by a key of their inputs; safe for threads.

    Parameters
    ----------
    size
        Largest number of results; the oldest one is removed first.
    """

    def __init__(self, size: int) -> None:
        self._size, self._lock = size, threading.Lock()
        self._results: dict[Key, Value] = {}

    def get(self, key: Key, compute: Callable[[], Value]) -> Value:
        """Result for a key, computed where it is not in the cache."""
        result = self._results.get(key)
        if result is None:
            result = compute()
            with self._lock:
                while len(self._results) >= self._size:
                    del self._results[next(iter(self._results))]
                self._results[key] = result
        return result

    def clear(self) -> None:
        """Remove all results."""
        with self._lock:
            self._results.clear()
