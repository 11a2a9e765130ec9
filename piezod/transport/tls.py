"""Modbus/TCP Security: the same frames through TLS, both sides with a certificate, and no way back to plain.

MB-TCP-Security-v21 (Modbus Organization, 2018): TLS 1.2 or later, mutual authentication, port 802. The role that a
client certificate may carry is the device's to judge.
"""

import contextlib
import os
import select
import socket
import ssl
import stat
from pathlib import Path
from time import monotonic

from piezod.config.link import ModbusTcpLink, TlsConfig
from piezod.errors import ConfigurationError, IdentityError, PiezodError

HOLDS_BYTES = 16384  # the longest TLS record
REFUSAL_S = 0.1  # with TLS 1.3 a device says only after the handshake that it does not want our certificate


class TlsStream:
    """A TLS connection that is used like a socket and waited for like a poll object.

    A readable socket may hold no data at all (a session ticket) and data may wait where no socket shows it, so waiting
    means reading ahead.

    Parameters
    ----------
    connection
        Connected and non-blocking; owned from here on.
    context
        What is verified, and what is shown.
    name
        What the device's certificate must name.
    deadline_s
        For the handshake, monotonic.

    Raises
    ------
    OSError
        No TLS, another certificate, or too late; `ssl.SSLError` is one.
    """

    __slots__ = ("_at", "_buffer", "_end", "_socket", "_view", "_waiter", "ended", "reason")

    def __init__(self, connection: socket.socket, context: ssl.SSLContext, name: str, deadline_s: float) -> None:
        self._socket = context.wrap_socket(connection, server_hostname=name, do_handshake_on_connect=False)
        self._waiter = select.poll()
        self._buffer = bytearray(HOLDS_BYTES)
        self._view = memoryview(self._buffer)
        self._at = self._end = 0
        self.ended = False
        self.reason = ""
        try:
            self._shake_hands(deadline_s)
        except BaseException:
            self._socket.close()
            raise

    def _shake_hands(self, deadline_s: float) -> None:
        while True:
            try:
                self._socket.do_handshake()
            except ssl.SSLWantReadError:
                wanted = select.POLLIN
            except ssl.SSLWantWriteError:
                wanted = select.POLLOUT
            else:
                self._waiter.register(self._socket, select.POLLIN)
                return
            self._waiter.register(self._socket, wanted)
            if not self._waiter.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
                raise TimeoutError

    def fileno(self) -> int:
        """Of the socket below."""
        return self._socket.fileno()

    def poll(self, timeout_ms: float) -> bool:
        """Wait until there is data, or the end."""
        deadline_s = monotonic() + 1e-3 * timeout_ms
        while self._at == self._end and not self.ended:
            try:
                self._at, self._end = 0, self._socket.recv_into(self._view)
                self.ended = self._end == 0
            except ssl.SSLWantReadError:
                if not self._waiter.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
                    return False
            except OSError as error:
                self.ended, self.reason = True, explain(error)
        return True

    def recv_into(self, space: memoryview) -> int:
        """Hand out what was read ahead; 0 at the end."""
        count = min(len(space), self._end - self._at)
        space[:count] = self._view[self._at : self._at + count]
        self._at += count
        return count

    def send(self, frame: bytes | bytearray) -> int:
        """Send a frame; raises OSError."""
        return self._socket.send(frame)

    def close(self) -> None:
        """Close without farewell: the device need not answer."""
        with contextlib.suppress(OSError):
            self._socket.close()


def make_context(config: TlsConfig) -> ssl.SSLContext:
    """Build what verifies the device and shows our certificate.

    Raises
    ------
    ConfigurationError
        A file is missing, does not fit, or lets everybody read the key.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # verifies certificate and host name
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    ca, certificate, key = (_path_of(getattr(config, name), name) for name in ("ca", "certificate", "key"))
    if key.stat().st_mode & stat.S_IROTH:
        raise ConfigurationError(f"link.tls.key: {key} can be read by everybody; chmod 600 it")
    try:
        context.load_verify_locations(cafile=ca)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(f"link.tls.ca: {ca}: {explain(error)}; must be certificates in PEM") from error
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(
            f"link.tls.certificate: {certificate} and {key}: {explain(error)}; must be a certificate and its key in PEM"
        ) from error
    return context


def _path_of(text: str, name: str) -> Path:
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    if text.startswith("$") and folder is None:
        raise ConfigurationError(f"link.tls.{name} is {text}, but systemd gave no credentials; see LoadCredential=")
    path = Path(text.replace("$CREDENTIALS_DIRECTORY", folder or "", 1))
    if not path.is_file():
        raise ConfigurationError(f"link.tls.{name}: {path} is no file")
    return path


def refusal(config: ModbusTcpLink, error: OSError) -> PiezodError | None:
    """Say what is wrong between us and the device; None when it is nothing of TLS."""
    where = f"link: {config.host}:{config.port}"
    if isinstance(error, ssl.SSLCertVerificationError):
        return IdentityError(
            f"{where}: its certificate is refused: {error.verify_message}; check link.tls.ca and link.tls.server_name"
        )
    if isinstance(error, ssl.SSLError):
        return ConfigurationError(f"{where}: no TLS connection: {explain(error)}; check port and both certificates")
    return None


def explain(error: OSError) -> str:
    """Words for what OpenSSL or the system reports."""
    reason = getattr(error, "reason", None) or error.strerror or str(error)
    return str(reason).lower().replace("_", " ")
