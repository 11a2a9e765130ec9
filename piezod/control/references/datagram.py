"""The check of one datagram of a stream: size, authenticity, order, time and range.

    sequence (uint64) | time [ns] (uint64) | value [N] (float64)                                24 bytes
    session (uint64) | sequence | time | value                                                  32 bytes
    session | sequence | time | value | tag (16 bytes)                                          48 bytes, with a key

All numbers are little-endian. The tag is the first half of HMAC-SHA256 over the 32 bytes before it. A higher session
number starts the sequence anew; a lower one is refused. Without a session number the session is 0.
"""

import hmac
import os
import struct
from math import isfinite
from pathlib import Path

from piezod.config.reference_range import ReferenceRange
from piezod.config.regular_file import open_regular
from piezod.control.references.counts import ValueResult
from piezod.errors import ConfigurationError
from piezod.runtime import clock

_PLAIN = struct.Struct("<QQd")
_WITH_SESSION = struct.Struct("<QQQd")
TAG_BYTES = 16
LARGEST = _WITH_SESSION.size + TAG_BYTES  # size of the largest datagram [byte]
FIRST_BELOW = 2**63
"""Bound for the first number of a session, and for a session number: higher ones leave no room for later ones."""
JUMP = 1_000_000
"""Largest rise of the sequence number between two datagrams, besides two for each nanosecond between them."""
LEAST_KEY_BYTES = 16
LARGEST_KEY_FILE = 4096  # [byte]


class DatagramGate:
    """Accepts or refuses one datagram after the other.

    Parameters
    ----------
    key
        Shared key; None: datagrams carry no tag.
    stamp_within_s
        Largest difference of the sender's time and the wall clock [s]; None: the time is not checked.

    Attributes
    ----------
    value_N
        Value of the datagram that was accepted last [N].
    """

    def __init__(self, allowed: ReferenceRange, key: bytes | None = None, stamp_within_s: float | None = None) -> None:
        self._low_N, self._high_N = allowed.low_N, allowed.high_N
        self._key = key
        self._stamp_within_ns = None if stamp_within_s is None else round(stamp_within_s * 1e9)
        self._session = self._sequence = -1
        self._accepted_ns = 0
        self.value_N = 0.0

    def begin(self) -> None:
        """Accept any sequence number next; with a key the order stays, so that no recorded datagram is accepted."""
        if self._key is None:
            self._session = self._sequence = -1

    def check(self, datagram: memoryview, now_ns: int) -> ValueResult:
        """Check a datagram; after `ACCEPTED` its value is in `value_N`.

        Parameters
        ----------
        datagram
            Received bytes.
        now_ns
            Monotonic time of its arrival [ns].
        """
        size = len(datagram)
        if self._key is not None and (size != LARGEST or not _is_authentic(self._key, datagram)):
            return ValueResult.UNAUTHENTICATED
        session = 0
        if size == _PLAIN.size:
            sequence, stamp_ns, value_N = _PLAIN.unpack_from(datagram)
        elif size == _WITH_SESSION.size or self._key is not None:
            session, sequence, stamp_ns, value_N = _WITH_SESSION.unpack_from(datagram)
        else:
            return ValueResult.MALFORMED
        result = self._order(session, sequence, now_ns)
        if result is ValueResult.ACCEPTED:
            result = self._value(value_N, stamp_ns)
        if result is ValueResult.ACCEPTED:
            self._session, self._sequence, self._accepted_ns, self.value_N = session, sequence, now_ns, value_N
        return result

    def _value(self, value_N: float, stamp_ns: int) -> ValueResult:
        if not isfinite(value_N):
            return ValueResult.MALFORMED
        if not self._low_N <= value_N <= self._high_N:
            return ValueResult.OUT_OF_RANGE
        if self._stamp_within_ns is not None and abs(clock.wall_ns() - stamp_ns) > self._stamp_within_ns:
            return ValueResult.MISTIMED
        return ValueResult.ACCEPTED

    def _order(self, session: int, sequence: int, now_ns: int) -> ValueResult:
        if session > self._session:
            is_wild = session >= FIRST_BELOW or sequence >= FIRST_BELOW
            return ValueResult.JUMPED if is_wild else ValueResult.ACCEPTED
        if session < self._session or sequence <= self._sequence:
            return ValueResult.OUT_OF_ORDER
        is_wild = sequence - self._sequence > JUMP + 2 * (now_ns - self._accepted_ns)
        return ValueResult.JUMPED if is_wild else ValueResult.ACCEPTED


def _is_authentic(key: bytes, datagram: memoryview) -> bool:
    signed, tag = datagram[:-TAG_BYTES], datagram[-TAG_BYTES:]
    return hmac.compare_digest(hmac.digest(key, signed, "sha256")[:TAG_BYTES], tag)


def read_key(text: str) -> bytes:
    """Read the shared key of a stream: hexadecimal digits in a file that only owner and group can read.

    Parameters
    ----------
    text
        `reference.key_file`: an absolute path, or a path that begins with `$CREDENTIALS_DIRECTORY/`.

    Raises
    ------
    ConfigurationError
        The file is missing, is open to others, belongs to another user, or holds no key.
    """
    name = "reference.key_file"
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    if text.startswith("$") and folder is None:
        raise ConfigurationError(f"{name} is {text}, but systemd gave no credentials; set LoadCredential=")
    path = Path(text.replace("$CREDENTIALS_DIRECTORY", folder or "", 1))
    try:
        with open_regular(path, LARGEST_KEY_FILE) as file:
            status, content = os.fstat(file.fileno()), file.read()
    except (OSError, ConfigurationError) as error:
        raise ConfigurationError(f"{name}: {error}") from error
    if status.st_mode & 0o037:
        raise ConfigurationError(
            f"{name}: {path} has mode {status.st_mode & 0o777:04o}, must be 0640 or less; chmod it"
        )
    if status.st_uid not in (0, os.geteuid()):
        raise ConfigurationError(f"{name}: {path} belongs to user {status.st_uid}, must belong to root or the daemon")
    try:
        key = bytes.fromhex(content.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) < LEAST_KEY_BYTES:
        raise ConfigurationError(
            f"{name}: {path} has no key, must be at least {2 * LEAST_KEY_BYTES} hexadecimal digits; "
            "make it with: openssl rand -hex 32"
        )
    return key
