"""Names of hosts in a bench file, an address or a name of RFC 1123, and in requests of the web."""

import re
from collections.abc import Collection
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

LOCAL_NAMES = ("127.0.0.1", "localhost")
LONGEST_NAME, LONGEST_LABEL = 253, 63  # characters, RFC 1035 section 2.3.4
_LABEL = re.compile(r"[^\W_](?:[\w-]*[^\W_])?|_[\w-]*")  # letters of every script: the resolver encodes them


def check_host(host: str) -> str:
    """Return a host that can exist.

    Parameters
    ----------
    host
        IPv4 or IPv6 address, with a zone if need be, or a name.

    Raises
    ------
    ValueError
        The name holds a space, a port or an address of the web, has an empty label, or is too long.
    """
    if address_of(host) is None and (reason := _reason(host)):
        raise ValueError(f"no host has the name {host[:LONGEST_LABEL]!r}: {reason}")
    return host


def address_of(host: str) -> IPv4Address | IPv6Address | None:
    """Address that a host is given by; None: it is given by a name."""
    try:
        return ip_address(host.partition("%")[0])
    except ValueError:
        return None


def _reason(host: str) -> str:
    """Why a name cannot exist; empty: it can."""
    labels = host.removesuffix(".").split(".")
    reasons = {
        f"it has {len(host)} characters, must have at most {LONGEST_NAME}": len(host) > LONGEST_NAME,
        "it contains a space; remove it": any(character.isspace() for character in host),
        "write the name alone, without a protocol or a path": "/" in host,
        "write the number behind ':' as port": ":" in host,
        "an address has four numbers from 0 to 255": all(label.isdecimal() for label in labels),
    }
    return next((reason for reason, holds in reasons.items() if holds), "") or _label_reason(labels)


def _label_reason(labels: list[str]) -> str:
    """Why one of the parts between points cannot exist; empty: all can."""
    for label in labels:
        if not label:
            return "a part between two points is empty"
        if len(label) > LONGEST_LABEL:
            return f"the part {label[:8]}... has {len(label)} characters, must have at most {LONGEST_LABEL}"
        if not _LABEL.fullmatch(label):
            return f"the part {label!r} may hold letters, digits and inner hyphens only"
    return ""


HostName = Annotated[str, Field(min_length=1), AfterValidator(check_host)]


def is_permitted(host: str, origin: str | None, names: Collection[str]) -> bool:
    """Whether a request comes under a known name, and from no foreign page.

    A browser sends the name that the user opened as `Host`. A foreign page whose name is bound to 127.0.0.1 (DNS
    rebinding) therefore shows itself by its name. `Origin` is sent with scripts of a page: it must be the page itself.

    Parameters
    ----------
    host, origin
        Headers `Host` and `Origin`; None: there is no `Origin`.
    names
        Known names in lower case, without port.
    """
    try:
        is_known = (urlsplit(f"//{host}").hostname or "") in names and "@" not in host
        return is_known and (origin is None or urlsplit(origin).netloc.lower() == host.lower())
    except ValueError:
        return False
