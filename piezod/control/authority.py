"""The order of authority: which demand moves the output in a tick, where to, and how fast.

    stop > fault > limit of the operator > comfort (ramp, acceleration, approach) > reference

`AUTHORITY` is this order as a table. The first demand that holds in a tick is obeyed alone; a lower one never slows it.
An acceleration limit spares the load in normal operation. A stop or a fault ignores it: the output turns at once, or
within `limits.deceleration_V_per_s2` where the load is too inert for that. The force interlock counts this way ahead.
The slew limit of the amplifier holds for every demand: the hardware cannot do more.
"""

from enum import IntEnum
from typing import NamedTuple


class Demand(IntEnum):
    """Demand on the output; a smaller number has more authority."""

    STOP = 0  # `piezod stop`, and everything else that asks for a fast stop
    DANGER = 1  # fault whose cause is a force, or an amplifier that reports a fault
    FAULT = 2  # every other fault
    SUSPECT = 3  # a force outside its limits; the next sample decides
    DISARM = 4  # `piezod disarm`, SIGTERM, end of a reference
    REFERENCE = 5


class Motion(NamedTuple):
    """Motion of the output.

    Attributes
    ----------
    to_safe
        Toward the safe voltage; False: toward the planned voltage.
    at_slew
        At the slew limit; False: at the comfortable rate, `limits.ramp_down_V_per_s` or that of the approach.
    at_once
        Without the acceleration limit; with `limits.deceleration_V_per_s2` if there is one.
    """

    to_safe: bool
    at_slew: bool
    at_once: bool


AUTHORITY = {
    Demand.STOP: Motion(to_safe=True, at_slew=True, at_once=True),
    Demand.DANGER: Motion(to_safe=True, at_slew=True, at_once=True),
    Demand.FAULT: Motion(to_safe=True, at_slew=False, at_once=True),
    Demand.SUSPECT: Motion(to_safe=True, at_slew=False, at_once=True),
    Demand.DISARM: Motion(to_safe=True, at_slew=False, at_once=False),
    Demand.REFERENCE: Motion(to_safe=False, at_slew=False, at_once=False),
}
"""Motion of each demand, by falling authority."""
