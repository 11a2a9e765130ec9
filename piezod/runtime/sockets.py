"""Sockets, names of hosts, and waiting for descriptors."""

import select as _select
import selectors
import socket as _socket

socket = _socket.socket
"""A socket, as `socket.socket`."""
getaddrinfo = _socket.getaddrinfo
"""Addresses of a host, as `socket.getaddrinfo`."""
if hasattr(_select, "poll"):  # systems without it drive no bench
    poll = _select.poll
    """Wait for some descriptors, as `select.poll`."""
select = _select.select
"""As `select.select`."""
DefaultSelector = selectors.DefaultSelector
"""As `selectors.DefaultSelector`."""
