"""An ophyd-async device of a bench, over the records of piezod.db: read in a scan, armed and disarmed by staging.

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

ARMED_WITHIN_S = 60.0  # reset cycle and approach included


class PiezodBench(StandardReadable, EpicsDevice):
    """Force, reference and voltage of a bench that `piezod run` drives.

    Staging arms it and waits until the reference is followed; unstaging ramps down.

    Parameters
    ----------
    prefix
        Of the records, such as `BENCH:`.
    name
        Of the device.
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
        """Arm, and wait until the reference is followed; a bench that faults instead is no success."""
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
