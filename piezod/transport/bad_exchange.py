"""The bytes of the last failed exchange, for support: request, reply, time, result.

    memory   version | time [ns] | result | link | request bytes | reply bytes | request | reply

The memory is allocated once and may be shared with another process. Good exchanges do not touch it. The version is odd
during a write; a reader that sees an odd or a changed version reads again.
"""

import struct
import time
from typing import Any

from piezod.runtime import clock
from piezod.transport.link import ExchangeResult

KEPT_BYTES = 300  # longest part of a request or a reply that is kept [bytes]; the longest Modbus frame has 260
LINKS = ("link", "load_cell_link")  # sections of the bench configuration, by the number in the memory
_HEAD = struct.Struct("<6q")
SIZE = _HEAD.size + 2 * KEPT_BYTES  # size of the memory [bytes]
READS = 10  # attempts against a writer; a write takes microseconds


class BadExchange:
    """Writer; one for each link."""

    __slots__ = ("_link", "_memory")

    def __init__(self) -> None:
        self._memory = memoryview(bytearray(SIZE))
        self._link = 0

    def use(self, cells: Any, link: int) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Write into this memory from now on.

        Parameters
        ----------
        cells
            Memory of `SIZE` bytes, such as `multiprocessing.RawArray`. Links of one pair share it.
        link
            Index in `LINKS`.
        """
        self._memory, self._link = memoryview(cells).cast("B"), link

    def keep(
        self, result: ExchangeResult, request: bytes | bytearray, reply: bytes | bytearray | memoryview, size: int
    ) -> None:
        """Replace the last failed exchange.

        Parameters
        ----------
        request
            Transmitted frame or line.
        reply
            Receive buffer; its first `size` bytes are the reply.
        """
        memory, sent = self._memory, len(request)
        version = _HEAD.unpack_from(memory)[0]
        struct.pack_into("<q", memory, 0, version + 1)
        length, at = min(sent, KEPT_BYTES), _HEAD.size
        memory[at : at + length] = request[:length]
        length, at = min(size, KEPT_BYTES), _HEAD.size + KEPT_BYTES
        memory[at : at + length] = reply[:length]
        _HEAD.pack_into(memory, 0, version + 1, clock.wall_ns(), result, self._link, sent, size)
        struct.pack_into("<q", memory, 0, version + 2)

    def as_dict(self) -> dict[str, object] | None:
        """The exchange as `read_bad_exchange` returns it."""
        return read_bad_exchange(self._memory)


def read_bad_exchange(cells: Any) -> dict[str, object] | None:  # noqa: ANN401  # any object with the buffer protocol
    """Read the last failed exchange; None: there was none.

    Parameters
    ----------
    cells
        Memory of a `BadExchange`.

    Returns
    -------
    dict or None
        `count` of failed exchanges, `time` (UTC), `result`, `link`. `request` and `reply` are in hexadecimal, at most
        `KEPT_BYTES` of their `request_bytes` and `reply_bytes`.
    """
    memory = memoryview(cells).cast("B")
    for _ in range(READS):
        copy = bytes(memory)
        version, time_ns, result, link, sent, received = _HEAD.unpack_from(copy)
        if version % 2 == 0 and version == _HEAD.unpack_from(memory)[0]:
            break
    if version == 0:
        return None
    request = copy[_HEAD.size : _HEAD.size + KEPT_BYTES][:sent]
    reply = copy[_HEAD.size + KEPT_BYTES :][:received]
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return {
        "count": version // 2,
        "time": f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(seconds))}.{rest_ns // 1_000_000:03d}Z",
        "result": ExchangeResult(result).name.lower(),
        "link": LINKS[link],
        "request": request.hex(" "),
        "reply": reply.hex(" "),
        "request_bytes": sent,
        "reply_bytes": received,
    }
