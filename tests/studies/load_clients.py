"""Clients of the socket and viewers of the live page, in a process of their own.

python -m tests.studies.load_clients clients SOCKET SECONDS
python -m tests.studies.load_clients viewers ADDRESS inf
"""

import asyncio
import json
import re
import sys
import time

from tests.studies.load import CLIENTS, VIEWERS

LONGEST_ANSWER = 1 << 20
EVERY_S = 1.0  # between two requests of a client


async def _client(path: str, number: int, end_s: float, waits_s: list[float]) -> str:
    """Ask for the status once a second on one connection; the result is why it was ended, or an empty text."""
    await asyncio.sleep(EVERY_S * number / CLIENTS)
    reader, writer = await asyncio.open_unix_connection(path, limit=LONGEST_ANSWER)
    try:
        while time.monotonic() < end_s:
            begun_s = time.monotonic()
            writer.write(b'{"command": "status"}\n')
            answer = json.loads(await reader.readline())
            if not answer["ok"]:
                return str(answer["error"])
            waits_s.append(time.monotonic() - begun_s)
            await asyncio.sleep(EVERY_S)
    except (OSError, ValueError) as error:
        return f"{type(error).__name__}: {error}"
    finally:
        writer.close()
    return ""


async def _clients(path: str, seconds: float) -> None:
    waits_s: list[float] = []
    end_s = time.monotonic() + seconds
    ends = await asyncio.gather(*(_client(path, number, end_s, waits_s) for number in range(CLIENTS)))
    refused = [end for end in ends if end]
    told = {"answers": len(waits_s), "slowest_s": max(waits_s, default=0.0), "refused": len(refused)}
    print(json.dumps(told | {"reason": refused[0] if refused else ""}), flush=True)


async def _viewer(address: str) -> None:
    """Open the live page as a browser does, and take what it sends until the process is ended."""
    from tornado.httpclient import AsyncHTTPClient  # of this part only
    from tornado.websocket import websocket_connect

    page = (await AsyncHTTPClient().fetch(address)).body.decode()
    token = re.search(r'"token":"([^"]+)"', page)
    if token is None:
        raise RuntimeError(f"{address}: no session in the page")
    url = address.replace("http:", "ws:").rstrip("/") + "/ws"
    connection = await websocket_connect(url, subprotocols=["bokeh", token[1]])
    first = await connection.read_message()
    print("viewing", flush=True)
    while first is not None and await connection.read_message() is not None:
        pass


async def _viewers(address: str) -> None:
    await asyncio.gather(*(_viewer(address) for _ in range(VIEWERS)))


if __name__ == "__main__":
    if sys.argv[1] == "clients":
        asyncio.run(_clients(sys.argv[2], float(sys.argv[3])))
    else:
        asyncio.run(_viewers(sys.argv[2]))
