"""Parsers with a deliberate defect, each of which the fuzzer must find."""

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
    """A refusal with two lines, which is not allowed."""

    def __str__(self) -> str:
        return "this\nand that"


def _grows(path: Path) -> None:
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


def accepts_any_transaction() -> Check:
    """A Modbus TCP link that accepts a reply with any transaction id."""
    dialogues = frames._modbus("tcp")

    def classify(request: frames.Request, received: int, wire: frames.TcpWire) -> tuple[ExchangeResult, int]:
        wire._buffer[0:2] = request.reply_head[0:2]
        return original(wire, request, received)

    original = frames.TcpWire._classify_first_frame

    class AnyTransactionWire(frames.TcpWire):
        def _classify_first_frame(self, request, received):
            return classify(request, received, self)

    for dialogue in dialogues:
        dialogue.wire = dialogue.link._wire = AnyTransactionWire(dialogue.wire._config)
    return frames.check_with(dialogues)


def ignores_the_checksum() -> Check:
    """An RTU link that does not check the checksum."""
    dialogues = frames._modbus("rtu")

    class WithoutChecksumWire(frames.RtuWire):
        def _receive(self, request, deadline_s):
            received = 0
            while received < request.reply_size:
                if not self._port.wait(deadline_s):
                    return ExchangeResult.TIMEOUT
                received += self._port.receive(received)
            good = self._port.buffer.startswith(request.reply_head)
            return ExchangeResult.OK if good else ExchangeResult.BAD_CRC

    for dialogue in dialogues:
        wire = WithoutChecksumWire(dialogue.wire._config)
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
    Target("grows", "broken", _seeds, lambda: files.from_file(".txt", _grows)),
    Target("asks_for_too_much", "broken", _seeds, lambda: files.from_file(".txt", _asks_for_too_much)),
    Target(
        "accepts_any_transaction", "broken", lambda: frames.seeds_of(frames._modbus("tcp")), accepts_any_transaction
    ),
    Target("ignores_the_checksum", "broken", lambda: frames.seeds_of(frames._modbus("rtu")), ignores_the_checksum),
]
