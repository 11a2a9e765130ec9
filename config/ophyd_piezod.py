"""An ophyd-async device for a bench, over the EPICS records of piezod.db.

A scan reads it; staging arms it and unstaging disarms it.

from ophyd_async.core import init_devices
from ophyd_piezod import PiezodBench

async with init_devices():
bench = PiezodBench("BENCH:")
RE(bp.count([bench], num=10, delay=1.0))
"""

import asyncio
from typing import Annotated

from ophyd_async.core import AsyncStatus, SignalR, SignalX, StandardReadable, wait_for_value
from ophyd_async.core import StandardReadableFormat as Format
from ophyd_async.epics.core import EpicsDevice, PvSuffix

ARMED_WITHIN_S = 60.0  # time limit, including reset cycle and approach


class PiezodBench(StandardReadable, EpicsDevice):
    """Force, reference and voltage of a bench that `piezod run` drives.

    Staging arms the bench and waits until it follows the reference; unstaging ramps down.

    Parameters
    ----------
    prefix
        Prefix of the records, such as `BENCH:`.
    name
        Name of the device.
    """

    force_N: Annotated[SignalR[float], PvSuffix("FORCE"), Format.HINTED_SIGNAL]
    reference_N: Annotated[SignalR[float], PvSuffix("REFERENCE"), Format.HINTED_SIGNAL]
    voltage_V: Annotated[SignalR[float], PvSuffix("VOLTAGE"), Format.HINTED_SIGNAL]
    state: Annotated[SignalR[str], PvSuffix("STATE"), Format.CONFIG_SIGNAL]
    arm: Annotated[SignalX, PvSuffix("ARM.PROC")]
    disarm: Annotated[SignalX, PvSuffix("DISARM.PROC")]
    stop_now: Annotated[SignalX, PvSuffix("STOP.PROC")]

    @AsyncStatus.wrap
    async def stage(self) -> None:
        """Arm and wait until the bench follows the reference; raise RuntimeError in FAULT."""
        await asyncio.gather(super().stage())
        await self.arm.trigger()
        await wait_for_value(self.state, lambda state: state in ("RUNNING", "FAULT"), ARMED_WITHIN_S)
        if await self.state.get_value() == "FAULT":
            raise RuntimeError(f"{self.name}: the bench is in FAULT; see piezod status")

    @AsyncStatus.wrap
    async def unstage(self) -> None:
        """Ramp down."""
        await self.disarm.trigger()
        await asyncio.gather(super().unstage())
