"""The control loop and what it is made of; nothing here knows a solver or a plot."""

from piezod.control.arming import check_named, check_ready
from piezod.control.loop import ControlLoop, LoopCounts
from piezod.control.rate_keeper import RateKeeper, RealRateKeeper, VirtualRateKeeper
from piezod.control.realtime import RealTimeWarning, real_time
from piezod.control.references import Reference, TableReference, make_reference
from piezod.control.segment_planner import Segment
from piezod.control.supervisor import CAUSE_TEXT, Cause, State
from piezod.recording.ring_log import ROW_DTYPE, RingLog, RingReader

__all__ = [
    "CAUSE_TEXT",
    "ROW_DTYPE",
    "Cause",
    "ControlLoop",
    "LoopCounts",
    "RateKeeper",
    "RealRateKeeper",
    "RealTimeWarning",
    "Reference",
    "RingLog",
    "RingReader",
    "Segment",
    "State",
    "TableReference",
    "VirtualRateKeeper",
    "check_named",
    "check_ready",
    "make_reference",
    "real_time",
]
