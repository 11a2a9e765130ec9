"""MQTT: the newest tick and the status of a daemon as JSON.

piezod/BENCH/online   1 or 0, retained; 0 is the last will
piezod/BENCH/tick     newest values in SI units, ten times a second
piezod/BENCH/status   answer of the daemon to `status`, once a second, retained
"""

import asyncio
import json
import ssl
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote, urlsplit

from piezod.bridge.values import Newest
from piezod.config import BenchConfig
from piezod.errors import ConfigurationError, PiezodError, UsageError

TICK_EVERY_S, STATUS_EVERY_S = 0.1, 1.0
RECONNECT_S = (1.0, 2.0, 5.0, 10.0)  # pauses before attempts in a row [s]; the last value repeats
KEEPALIVE_S = 5  # silence after which the broker publishes the last will, times 1.5 [s]
ANSWER_WITHIN_S = 2.0  # longest wait for a broker [s]; a dead one is asked twice at the end
PORTS = {"mqtt": 1883, "mqtts": 8883}

SendCommand = Callable[[str], dict[str, Any]]


@dataclass(frozen=True)
class Broker:
    """Address of an MQTT broker.

    Parameters
    ----------
    host, port
        Where it listens.
    encrypted
        Whether by TLS, with the certificates of the system.
    user, password
        Empty: none.
    """

    host: str
    port: int
    encrypted: bool
    user: str = ""
    password: str = field(default="", repr=False)

    @classmethod
    def of(cls, url: str) -> "Broker":
        """Address from `mqtt://[USER:PASSWORD@]HOST[:PORT]`, or `mqtts://...` for TLS.

        Raises
        ------
        UsageError
            The text is no such address.
        """
        try:
            parts = urlsplit(url)
            port = parts.port or PORTS.get(parts.scheme, 0)
        except ValueError:
            parts, port = urlsplit(""), 0
        if parts.scheme not in PORTS or not parts.hostname or parts.path.strip("/"):
            shown = url.rpartition("@")[2]  # without a password
            raise UsageError(f"--mqtt is '{shown}', must be mqtt://[USER:PASSWORD@]HOST[:PORT] or mqtts://...")
        user, password = unquote(parts.username or ""), unquote(parts.password or "")
        return cls(parts.hostname, port, parts.scheme == "mqtts", user, password)


def topic_of(bench: str, name: str) -> str:
    """Topic of a bench; what has a meaning in a topic is replaced.

    Parameters
    ----------
    name
        `online`, `tick` or `status`.
    """
    return f"piezod/{''.join('-' if one in '/+# ' else one for one in bench)}/{name}"


async def publish(
    bench: BenchConfig, broker: Broker, send_command: SendCommand, announce: Callable[[str], None]
) -> None:
    """Publish until cancelled; connect again when the broker goes away.

    Parameters
    ----------
    bench
        Bench whose ring log is read.
    send_command
        Sends one command to the daemon and returns its answer.
    announce
        Called with one line when the connection comes or goes.

    Raises
    ------
    ConfigurationError
        The package aiomqtt is missing.
    """
    try:
        import aiomqtt  # noqa: PLC0415  # optional
    except ImportError as error:
        raise ConfigurationError("--mqtt needs aiomqtt; pip install 'piezod-bench[mqtt]'") from error
    online, newest, attempt = topic_of(bench.name, "online"), Newest(bench.ring_log_path, bench.dt_s), 0
    while True:
        try:
            async with aiomqtt.Client(
                broker.host,
                broker.port,
                username=broker.user or None,
                password=broker.password or None,
                keepalive=KEEPALIVE_S,
                timeout=ANSWER_WITHIN_S,
                will=aiomqtt.Will(online, b"0", qos=1, retain=True),
                tls_context=ssl.create_default_context() if broker.encrypted else None,
            ) as client:
                announce(f"mqtt: {broker.host}:{broker.port}, topics {topic_of(bench.name, '#')}")
                attempt = 0
                await client.publish(online, b"1", qos=1, retain=True)
                try:
                    await _publish_values(client, bench, newest, send_command)
                finally:
                    await client.publish(online, b"0", qos=1, retain=True)
        except aiomqtt.MqttError as error:
            if (task := asyncio.current_task()) is not None and task.cancelling():
                return  # the broker went away in the moment of the end
            pause_s = RECONNECT_S[min(attempt, len(RECONNECT_S) - 1)]
            if not attempt:
                announce(f"mqtt: {broker.host}:{broker.port}: {error}; trying again")
            attempt += 1
            await asyncio.sleep(pause_s)


async def _publish_values(client: Any, bench: BenchConfig, newest: Newest, send_command: SendCommand) -> None:  # noqa: ANN401  # of an optional library
    loop = asyncio.get_running_loop()
    ticks, status = topic_of(bench.name, "tick"), topic_of(bench.name, "status")
    next_status_s = loop.time()
    while True:
        values = await loop.run_in_executor(None, newest.read)
        if values is not None:
            await client.publish(ticks, json.dumps(values | {"stale": newest.stale}))
        elif newest.last is not None and newest.stale and loop.time() >= next_status_s:
            await client.publish(ticks, json.dumps(newest.last | {"stale": True, "age_s": newest.age.age_s}))
        if loop.time() >= next_status_s:
            next_status_s = loop.time() + STATUS_EVERY_S
            await client.publish(status, json.dumps(await loop.run_in_executor(None, asked, send_command)), retain=True)
        await asyncio.sleep(TICK_EVERY_S)


def asked(send_command: SendCommand) -> dict[str, Any]:
    """Status of the daemon; where it does not answer, the reason under `problem`.

    Parameters
    ----------
    send_command
        Sends one command to the daemon and returns its answer.
    """
    try:
        return send_command("status")
    except PiezodError as error:
        return {"problem": str(error)}
