"""The control loop and its parts: references, planner, limits, interlocks, supervisor and clock."""

from piezod.control.arming import check_ready, check_safeguards
from piezod.control.loop import ControlLoop, LoopCounts
from piezod.control.phase_times import PhaseTimes
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
    "PhaseTimes",
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
    "check_ready",
    "check_safeguards",
    "make_reference",
    "real_time",
]
