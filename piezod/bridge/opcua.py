"""OPC UA: the newest tick of a daemon as read-only nodes; methods for clients with a known certificate.

Without certificates the server listens on the loopback address, encrypts nothing and has no methods. With a folder of
certificates it accepts only these clients, signs and encrypts, and offers `arm`, `disarm` and `stop`.
"""

import asyncio
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from piezod.bridge.values import UNITS, Newest, Values
from piezod.config import BenchConfig
from piezod.errors import BusyError, ConfigurationError, PiezodError

ADDRESS = "127.0.0.1"  # another machine reaches it through ssh -L, or by a gateway
NAMESPACE = "urn:piezod"
UPDATE_EVERY_S = 0.1
COMMANDS = ("arm", "disarm", "stop")
TEXTS = ("state", "cause")

SendCommand = Callable[[str], dict[str, Any]]


async def serve(
    bench: BenchConfig,
    port: int,
    certificates: Path | None,
    send_command: SendCommand,
    announce: Callable[[str], None],
) -> None:
    """Serve until cancelled.

    Parameters
    ----------
    bench
        Bench whose ring log is read.
    port
        Port on the loopback address.
    certificates
        Folder with `server.der`, `server.pem` (its key) and `clients/*.der`; None: no methods.
    send_command
        Sends one command to the daemon and returns its answer.
    announce
        Called with a line that holds the address.

    Raises
    ------
    ConfigurationError
        The package asyncua or a certificate is missing.
    BusyError
        The port is in use.
    """
    try:
        from asyncua import Server  # noqa: PLC0415  # optional
        from asyncua.crypto.permission_rules import SimpleRoleRuleset  # noqa: PLC0415
        from asyncua.server.user_managers import CertificateUserManager  # noqa: PLC0415
        from asyncua.ua import SecurityPolicyType  # noqa: PLC0415
    except ImportError as error:
        raise ConfigurationError("--opcua needs asyncua; pip install 'piezod-bench[opcua]'") from error
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it warns of every client that leaves
    known = CertificateUserManager()
    server = Server(user_manager=known if certificates is not None else None)
    await server.init()
    server.set_endpoint(f"opc.tcp://{ADDRESS}:{port}/piezod/")
    server.set_server_name(f"piezod: {bench.name}")
    if certificates is None:
        server.set_security_policy([SecurityPolicyType.NoSecurity])
    else:
        clients = await _admit(known, certificates)
        server.set_security_policy([SecurityPolicyType.Basic256Sha256_SignAndEncrypt], SimpleRoleRuleset())
        await server.load_certificate(str(_existing(certificates / "server.der")))
        await server.load_private_key(str(_existing(certificates / "server.pem")))
    index = await server.register_namespace(NAMESPACE)
    folder = await server.nodes.objects.add_object(index, bench.name)
    nodes = {name: await folder.add_variable(index, name, "") for name in TEXTS}
    nodes |= {name: await folder.add_variable(index, name, math.nan) for name in UNITS}
    nodes["tick"] = await folder.add_variable(index, "tick", 0)
    if certificates is not None:
        for name in COMMANDS:
            await folder.add_method(index, name, _method(name, send_command), [], [])
    try:
        await server.start()
    except OSError as error:
        raise BusyError(f"--opcua is {port}, {ADDRESS}:{port} is taken; name another") from error
    mode = "read only" if certificates is None else f"methods for {clients} clients"
    announce(f"opc ua: opc.tcp://{ADDRESS}:{port}/piezod/  ({mode})")
    try:
        await _update(nodes, Newest(bench.ring_log_path, bench.dt_s))
    finally:
        await server.stop()


async def _update(nodes: dict[str, Any], newest: Newest) -> None:
    """Write the newest values to the nodes until cancelled, with the status of a lost source while they are stale."""
    from asyncua import ua  # noqa: PLC0415  # optional

    loop = asyncio.get_running_loop()
    while True:
        values, stale = await loop.run_in_executor(None, newest.read), newest.stale
        status = ua.StatusCode(ua.StatusCodes.BadNoCommunication if stale else ua.StatusCodes.Good)
        for name, node in nodes.items() if stale or values is not None else ():
            if name == "age_s":
                await node.write_value(math.nan if newest.age.age_s is None else newest.age.age_s)
            elif values is not None:
                await node.write_value(ua.DataValue(ua.Variant(_value(values, name)), status))
            else:
                last = await node.read_data_value(raise_on_bad_status=False)
                await node.write_value(ua.DataValue(last.Value, status))
        await asyncio.sleep(UPDATE_EVERY_S)


def _value(values: Values, name: str) -> float | int | str:
    value = values[name]
    return math.nan if value is None else value


async def _admit(known: Any, certificates: Path) -> int:  # noqa: ANN401  # of an optional library
    """Admit the clients of a folder; their number."""
    paths = sorted((certificates / "clients").glob("*.der"))
    if not paths:
        raise ConfigurationError(
            f"{certificates / 'clients'}: holds no *.der, must hold the certificate of each client"
        )
    for path in paths:
        await known.add_user(str(path), path.stem)
    return len(paths)


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise ConfigurationError(f"{path}: is missing; --certificates needs server.der, server.pem and clients/*.der")
    return path


def _method(name: str, send_command: SendCommand) -> Callable[..., Any]:
    """A method that sends a command to the daemon; the daemon admits or refuses it as any other."""

    async def called(_parent: object) -> list[Any]:
        from asyncua import ua  # noqa: PLC0415  # optional

        try:
            await asyncio.get_running_loop().run_in_executor(None, send_command, name)
        except PiezodError as error:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadInvalidState) from error
        return []

    return called
