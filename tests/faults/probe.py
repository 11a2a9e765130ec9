"""A probe for standstills of this machine: on each core a thread of the highest priority measures its late wake-ups.

`python -m tests.faults.probe` writes a line for each wake-up that was more than `STILL_MS` late, until it is killed.
A core of a virtual machine may stand still alone.
"""

import contextlib
import os
import subprocess
import sys
import threading
import time

STILL_MS = 4.0
SLEEP_S = 0.001


def watch(core):
    """Sleep repeatedly for 1 ms on one core and print each late wake-up."""
    os.sched_setaffinity(0, {core})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(99))
    before_ns = time.monotonic_ns()
    while True:
        time.sleep(SLEEP_S)
        now_ns = time.monotonic_ns()
        late_ms = (now_ns - before_ns) / 1e6 - 1e3 * SLEEP_S
        if late_ms > STILL_MS:
            sys.stdout.write(f"{before_ns} {now_ns} {late_ms:.1f}\n")
            sys.stdout.flush()
        before_ns = time.monotonic_ns()


class Probe:
    """The probe in a separate process; `stills` holds (begin [ns], end [ns], delay [ms])."""

    def __init__(self):
        self.stills = []
        self.process = subprocess.Popen([sys.executable, "-m", "tests.faults.probe"], stdout=subprocess.PIPE, text=True)
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        for line in self.process.stdout:
            begun, ended, late_ms = line.split()
            self.stills.append((int(begun), int(ended), float(late_ms)))

    def worst_ms(self, begun_ns):
        """The longest standstill that ended after `begun_ns` [ms]; 0 without any."""
        return max((late_ms for _, ended_ns, late_ms in self.stills if ended_ns >= begun_ns), default=0.0)

    def close(self):
        self.process.kill()
        self.process.wait()
        self._thread.join()
        self.process.stdout.close()


def repeated_after_standstills(probe, attempt, most=4):
    """Call `attempt(number)`; where its assertion fails and the machine stood still meanwhile, call it again.

    Parameters
    ----------
    probe
        A running probe.
    attempt
        Called with 0, 1, ...; each call is a complete test of its own.
    most
        Largest number of calls.
    """
    for number in range(most - 1):
        begun_ns = time.monotonic_ns()
        try:
            return attempt(number)
        except (AssertionError, KeyError):
            if probe.worst_ms(begun_ns) == 0.0:
                raise
    return attempt(most - 1)


if __name__ == "__main__":
    for core in os.sched_getaffinity(0):
        threading.Thread(target=watch, args=(core,)).start()
