"""Fault injection: the faults of `faults.yaml` on a running bench, with their expected results.

python -m tests.faults list              every fault of faults.yaml, and the time until the expected state
python -m tests.faults kills             repeated SIGKILL and SIGSTOP: the watchdog of the device makes it safe
python -m tests.faults replies           stale and false replies to the links and to plain pymodbus clients

With PIEZOD_UNDER_TEST=FOLDER the daemon is that of another checkout, such as an earlier version.
"""
