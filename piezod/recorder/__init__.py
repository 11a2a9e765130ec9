"""The recorder: a process that writes every tick of the ring log to the disk, and the daemon's side of it.

| file                 | runs in              | task                                                        |
|----------------------|----------------------|-------------------------------------------------------------|
| `watch.py`           | daemon               | starts the recorder process, restarts it, reports its state |
| `messages.py`        | both                 | plan, report, and the lines between the two processes       |
| `writer.py`          | recorder process     | entry point and main loop                                   |
| `ring_recorder.py`   | recorder process     | moves rows from the ring log to the current file            |
| `recording_files.py` | recorder process     | numbers, writes, closes and removes files                   |
"""
