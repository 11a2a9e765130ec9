"""The recorder: a process that writes every tick of the ring log to the disk, with its counterpart in the daemon.

In the daemon:

- `watch.py` starts the recorder process, restarts it, and reports its state.

In the recorder process:

- `writer.py` is the entry point and the main loop.
- `ring_recorder.py` moves rows from the ring log to the current file.
- `recording_files.py` numbers, writes, closes and removes files.
- `fault_files.py` writes the ticks around a fault to a file of their own.

In both: `messages.py` defines plan, report, and the lines between the two processes.
"""
