"""Modbus/TCP Security: Modbus TCP frames over TLS with certificates on both sides, without fallback to plain TCP.

MB-TCP-Security-v21 (Modbus Organization, 2018): TLS 1.2 or later, mutual authentication, port 802.
A client certificate may contain a role; the device checks it.
"""

import contextlib
import os
import select
import socket
import ssl
import stat
from pathlib import Path

from piezod.config.link import ModbusTcpLink, TlsConfig
from piezod.errors import ConfigurationError, IdentityError, PiezodError
from piezod.runtime import clock, sockets

HOLDS_BYTES = 16384  # maximum length of a TLS record
REFUSAL_S = 0.1  # in TLS 1.3 the device rejects the client certificate only after the handshake


class TlsStream:
    """A TLS connection with the methods of a socket and of a poll object.

    `poll` reads ahead. A readable socket may contain no data, for example only a session ticket.
    Decrypted data may wait inside OpenSSL while the socket is not readable.

    Parameters
    ----------
    connection
        Connected, non-blocking socket; this object closes it.
    context
        TLS context from `make_context`.
    name
        Host name that the device certificate must contain.
    deadline_s
        Time limit of the handshake on the monotonic clock [s].

    Raises
    ------
    OSError
        The handshake failed or timed out; `ssl.SSLError` is a subclass.
    """

    __slots__ = ("_at", "_buffer", "_end", "_socket", "_view", "_waiter", "ended", "reason")

    def __init__(self, connection: socket.socket, context: ssl.SSLContext, name: str, deadline_s: float) -> None:
        self._socket = context.wrap_socket(connection, server_hostname=name, do_handshake_on_connect=False)
        self._waiter = sockets.poll()
        self._buffer = bytearray(HOLDS_BYTES)
        self._view = memoryview(self._buffer)
        self._at = self._end = 0
        self.ended = False
        self.reason = ""
        try:
            self._handshake(deadline_s)
        except BaseException:
            self._socket.close()
            raise

    def _handshake(self, deadline_s: float) -> None:
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
            if not self._waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
                raise TimeoutError

    def fileno(self) -> int:
        """File descriptor of the socket."""
        return self._socket.fileno()

    def poll(self, timeout_ms: float) -> bool:
        """Wait until data is available or the connection ended; False: timeout."""
        deadline_s = clock.monotonic() + 1e-3 * timeout_ms
        while self._at == self._end and not self.ended:
            try:
                self._at, self._end = 0, self._socket.recv_into(self._view)
                self.ended = self._end == 0
            except ssl.SSLWantReadError:
                if not self._waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
                    return False
            except OSError as error:
                self.ended, self.reason = True, explain(error)
        return True

    def recv_into(self, space: memoryview) -> int:
        """Copy data that `poll` has read; 0: the connection ended."""
        count = min(len(space), self._end - self._at)
        space[:count] = self._view[self._at : self._at + count]
        self._at += count
        return count

    def send(self, frame: bytes | bytearray) -> int:
        """Send a frame; raises OSError."""
        return self._socket.send(frame)

    def close(self) -> None:
        """Close without a TLS close message."""
        with contextlib.suppress(OSError):
            self._socket.close()


def make_context(config: TlsConfig) -> ssl.SSLContext:
    """TLS context that verifies the device and presents the client certificate.

    Raises
    ------
    ConfigurationError
        A file is missing or invalid, or everybody can read the key.
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
        raise ConfigurationError(f"link.tls.{name} is {text}, but systemd gave no credentials; set LoadCredential=")
    path = Path(text.replace("$CREDENTIALS_DIRECTORY", folder or "", 1))
    if not path.is_file():
        raise ConfigurationError(f"link.tls.{name}: {path} is no file")
    return path


def tls_error(config: ModbusTcpLink, error: OSError) -> PiezodError | None:
    """Convert a TLS failure into an error with cause and remedy; None: not a TLS failure."""
    where = f"link: {config.host}:{config.port}"
    if isinstance(error, ssl.SSLCertVerificationError):
        return IdentityError(
            f"{where}: its certificate is refused: {error.verify_message}; check link.tls.ca and link.tls.server_name"
        )
    if isinstance(error, ssl.SSLError):
        return ConfigurationError(f"{where}: no TLS connection: {explain(error)}; check port and both certificates")
    return None


def explain(error: OSError) -> str:
    """Readable text for an error of OpenSSL or of the system.

    Parameters
    ----------
    error
        As raised by `ssl` or `socket`.

    Returns
    -------
    One line without a full stop, in lower case.
    """
    reason = getattr(error, "reason", None) or error.strerror or str(error)
    return str(reason).lower().replace("_", " ")
