"""Clocks and sleep."""

import time
from functools import partial

monotonic = time.monotonic
"""Monotonic time [s]; it stands while the machine is suspended."""
monotonic_ns = time.monotonic_ns
"""As `monotonic` [ns]."""
boot_ns = partial(time.clock_gettime_ns, getattr(time, "CLOCK_BOOTTIME", 7))
"""Monotonic time that includes the time in which the machine was suspended [ns]."""
perf_counter_ns = time.perf_counter_ns
"""Time stamp for durations within a process [ns]."""
process_time = time.process_time
"""Processor time of this process [s]."""
wall_s = time.time
"""Time since 1970 [s]; it may be set."""
wall_ns = time.time_ns
"""As `wall_s` [ns]."""
sleep = time.sleep
"""Wait for a time [s]."""
