"""Open files, pipes and ports by their descriptors."""

import fcntl
import os

open_file = os.open
"""Open a file, as `os.open`."""
close = os.close
"""Close a descriptor."""
read = os.read
"""Read bytes, as `os.read`."""
readv = os.readv
"""Read bytes into buffers, as `os.readv`."""
write = os.write
"""Write bytes, as `os.write`."""
pread = os.pread
"""Read bytes at a position, as `os.pread`."""
pwrite = os.pwrite
"""Write bytes at a position, as `os.pwrite`."""
truncate = os.ftruncate
"""Cut a file, as `os.ftruncate`."""
fsync = os.fsync
"""Write a file from the page cache to the disk."""
pipe = os.pipe
"""A pipe, as `os.pipe`."""
set_blocking = os.set_blocking
"""Whether reads and writes wait, as `os.set_blocking`."""
lock = fcntl.flock
"""Lock a file, as `fcntl.flock`."""
