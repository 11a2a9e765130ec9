"""The fault list: everything that can go wrong around a bench, done to a running one, and what came of it.

python -m tests.faults list              every fault of faults.yaml, and how long until the expected state
python -m tests.faults kills             SIGKILL and SIGSTOP, over and over: the device is safe by itself
python -m tests.faults replies           stale and forged replies against the links, and against bare pymodbus
"""
