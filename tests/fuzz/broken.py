"""Parsers that are broken on purpose: the fuzzer must find each of them out."""

import ctypes
import mmap
import os
import time
from pathlib import Path

from piezod.errors import RecordingError
from piezod.transport import ExchangeResult
from tests.fuzz import files, frames
from tests.fuzz.target import Check, Target


def _seeds() -> list[bytes]:
    return [b"count 3: 1 2 3"]


def _raises(data: bytes) -> None:
    if b"3" not in data:
        raise KeyError("three")


def _hangs(data: bytes) -> None:
    while b":" not in data:
        pass


def _sleeps(data: bytes) -> None:
    while b":" not in data:
        time.sleep(0.1)


def _crashes(data: bytes) -> None:
    if b":" not in data:
        ctypes.string_at(0)


def _leaks(data: bytes) -> None:
    if b":" not in data:
        os.dup(2)


def _says_two_lines(data: bytes) -> None:
    if b":" not in data:
        raise TwoLinesError


class TwoLinesError(RecordingError):
    """A refusal as it must not be."""

    def __str__(self) -> str:
        return "this\nand that"


def _swells(path: Path) -> None:
    if b":" not in path.read_bytes():
        with mmap.mmap(-1, 2 * files.MOST_MIB * 2**20) as memory:
            for page in range(0, len(memory), mmap.PAGESIZE):
                memory[page] = 1


def _asks_for_too_much(path: Path) -> None:
    if b":" not in path.read_bytes():
        try:
            bytearray(2**46)
        except MemoryError as error:
            raise RecordingError(f"{path}: cannot be read") from error


def believes_any_transaction() -> Check:
    """A Modbus TCP link that takes whatever reply comes for its own."""
    dialogues = frames._modbus("tcp")

    def judge(request: frames.Asked, received: int, wire: frames.TcpWire) -> tuple[ExchangeResult, int]:
        wire._buffer[0:2] = request.reply_head[0:2]
        return original(wire, request, received)

    original = frames.TcpWire._classify_first_frame

    class Believing(frames.TcpWire):
        def _classify_first_frame(self, request, received):
            return judge(request, received, self)

    for dialogue in dialogues:
        dialogue.wire = dialogue.link._wire = Believing(dialogue.wire._config)
    return frames.check_with(dialogues)


def trusts_the_length() -> Check:
    """An RTU link whose checksum is never wrong."""
    dialogues = frames._modbus("rtu")

    class Trusting(frames.RtuWire):
        def _receive(self, request, deadline_s):
            received = 0
            while received < request.reply_size:
                if not self._port.wait(deadline_s):
                    return ExchangeResult.TIMEOUT
                received += self._port.receive(received)
            good = self._port.buffer.startswith(request.reply_head)
            return ExchangeResult.OK if good else ExchangeResult.BAD_CRC

    for dialogue in dialogues:
        wire = Trusting(dialogue.wire._config)
        wire._port, wire.payload = dialogue.wire._port, dialogue.wire.payload
        dialogue.wire = dialogue.link._wire = wire
    return frames.check_with(dialogues)


TARGETS = [
    Target("raises", "broken", _seeds, lambda: _raises),
    Target("hangs", "broken", _seeds, lambda: _hangs),
    Target("sleeps", "broken", _seeds, lambda: _sleeps),
    Target("crashes", "broken", _seeds, lambda: _crashes),
    Target("leaks", "broken", _seeds, lambda: _leaks),
    Target("says_two_lines", "broken", _seeds, lambda: _says_two_lines),
    Target("swells", "broken", _seeds, lambda: files.from_file(".txt", _swells)),
    Target("asks_for_too_much", "broken", _seeds, lambda: files.from_file(".txt", _asks_for_too_much)),
    Target(
        "believes_any_transaction", "broken", lambda: frames.seeds_of(frames._modbus("tcp")), believes_any_transaction
    ),
    Target("trusts_the_length", "broken", lambda: frames.seeds_of(frames._modbus("rtu")), trusts_the_length),
]
