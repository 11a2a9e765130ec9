"""An EPICS IOC of one bench: the records of piezod.db by pythonSoftIOC, without StreamDevice.

    pip install softioc
    python piezod_ioc.py bench.yaml BENCH

It asks the daemon for its status twice a second, over the unix socket. A write to ARM, DISARM, STOP or RESET sends that
command; the daemon admits or refuses it as any other.
"""

import asyncio
import sys
from pathlib import Path

from softioc import alarm, asyncio_dispatcher, builder, softioc

from piezod.config import load_bench
from piezod.daemon.client import command_and_wait
from piezod.errors import PiezodError

ASK_EVERY_S = 0.5
VALUES = {"FORCE": ("force_N", "N"), "REFERENCE": ("reference_N", "N"), "VOLTAGE": ("voltage_V", "V")}
VALUES |= {"TEMPERATURE": ("temperature_C", "degC"), "MISSED": ("missed", ""), "AGE": ("age_s", "s")}
TEXTS = {"STATE": "state", "CAUSE": "cause"}
COMMANDS = ("ARM", "DISARM", "STOP", "RESET")


def main(bench: str, prefix: str) -> None:
    """Serve the records until SIGTERM."""
    path = load_bench(Path(bench)).socket_path
    dispatcher = asyncio_dispatcher.AsyncioDispatcher()
    builder.SetDeviceName(prefix)
    values = {name: builder.aIn(name, EGU=unit, PREC=3) for name, (_, unit) in VALUES.items()}
    texts = {name: builder.stringIn(name) for name in TEXTS}
    for name in COMMANDS:
        builder.longOut(name, on_update=_sender(path, name.lower()), always_update=True)
    builder.LoadDatabase()
    softioc.iocInit(dispatcher)

    async def poll() -> None:
        while True:
            try:
                status = await asyncio.to_thread(command_and_wait, path, "status", wait=False)
                stale = bool(status.get("stale"))
                for name, (key, _) in VALUES.items():
                    value = status.get(key)
                    severity = alarm.NO_ALARM if value is not None and not stale else alarm.INVALID_ALARM
                    values[name].set(value or 0.0, severity=severity, alarm=alarm.READ_ALARM)
                for name, key in TEXTS.items():
                    text = f"STALE, then {status.get(key)}" if stale and name == "STATE" else str(status.get(key) or "")
                    texts[name].set(text[:39])
            except PiezodError as error:
                for record in (*values.values(), *texts.values()):
                    record.set(record.get(), severity=alarm.INVALID_ALARM, alarm=alarm.COMM_ALARM)
                texts["CAUSE"].set(str(error)[:39], severity=alarm.INVALID_ALARM, alarm=alarm.COMM_ALARM)
            await asyncio.sleep(ASK_EVERY_S)

    dispatcher(poll)
    softioc.non_interactive_ioc()


def _sender(path: Path, name: str):  # noqa: ANN202  # a coroutine function
    async def send(_value: int) -> None:
        try:
            await asyncio.to_thread(command_and_wait, path, name, wait=False)
        except PiezodError as error:
            sys.stderr.write(f"{name}: refused: {error}\n")

    return send


if __name__ == "__main__":
    main(*sys.argv[1:])
