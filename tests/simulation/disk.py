"""The disk below the recorder: full, failing, slow or read-only; and what is on it at the end.

A commit of SQLite and each fsync go through `Disk.sync`, each new file through `Disk.create`. A commit that fails
leaves nothing behind, as SQLite promises. A disk that acknowledges what it does not keep is not simulated.
"""

import contextlib
import errno
import itertools
import os
import sqlite3
from collections import defaultdict

from piezod.errors import PiezodError
from piezod.recording.formats.sqlite import BlockReader, newest_block
from piezod.recording.formats.sqlite_tables import connect, read_about

SYNC_S = 0.001  # of a disk without a fault
FAULTS = ("full", "io_error", "slow", "read_only")
ERRORS = {"full": errno.ENOSPC, "io_error": errno.EIO, "read_only": errno.EROFS}
TEXTS = {"full": "database or disk is full", "io_error": "disk I/O error",
         "read_only": "attempt to write a readonly database"}  # fmt: skip


class Disk:
    """The disk of the history; `fault` is one of `FAULTS` or empty."""

    def __init__(self, machine):
        self.machine = machine
        self.fault, self.every, self.slow_s = "", 1, 5.0
        self.syncs = 0
        self.acknowledged, self.dropped = defaultdict(int), defaultdict(int)  # by session, from the reports

    def strike(self, fault, every=1, slow_s=5.0):
        """From now on the fault meets each sync whose number is a multiple of `every`."""
        self.fault, self.every, self.slow_s = fault, every, slow_s

    def heal(self):
        self.fault = ""

    def sync(self):
        """Wait for the disk; the fault that meets this sync, or an empty text."""
        machine = self.machine
        self.syncs += 1
        met = self.fault if self.syncs % self.every == 0 else ""
        if machine.current is not None:
            if met:
                machine.note("disk", met, machine.process.name)
            machine.sleep(self.slow_s if met == "slow" else SYNC_S)
        return "" if met == "slow" else met

    def fsync(self, descriptor):
        del descriptor  # the file is in memory
        if met := self.sync():
            raise OSError(ERRORS[met], os.strerror(ERRORS[met]))

    def create(self, flags):
        """Refuse a new file on a full or read-only disk."""
        if flags & os.O_CREAT and self.fault in ("full", "read_only"):
            raise OSError(ERRORS[self.fault], os.strerror(ERRORS[self.fault]))

    def connect(self, path, **settings):
        """As `sqlite3.connect`."""
        disk = self

        class Connection(sqlite3.Connection):
            def execute(self, statement, *parameters):
                if statement in ("COMMIT", "PRAGMA journal_mode = DELETE") and (met := disk.sync()):
                    if self.in_transaction:
                        super().execute("ROLLBACK")
                    raise sqlite3.OperationalError(TEXTS[met])
                return super().execute(statement, *parameters)

        connection = sqlite3.connect(path, factory=Connection, **settings)
        process = self.machine.process
        process.watchers.append(lambda: _abandon(connection))
        return connection

    # what the recorder has acknowledged, and what is there ---------------------------------------------------------

    def see(self, report):
        """Keep what a report acknowledges."""
        if report.session:
            self.acknowledged[report.session] = max(self.acknowledged[report.session], report.row)
            self.dropped[report.session] = max(self.dropped[report.session], report.dropped)

    def losses(self, folder):
        """Rows that were acknowledged and are in no file, and rows that are there twice or out of order."""
        found, wrong = defaultdict(set), 0
        for path in sorted(folder.glob("*.sqlite")):
            session, numbers = _rows_of(path)
            wrong += sum(after <= before for before, after in itertools.pairwise(numbers))
            wrong += len(found[session].intersection(numbers))
            found[session].update(numbers)
        lost = {
            session: missing
            for session, row in self.acknowledged.items()
            if (missing := row - self.dropped[session] - sum(number < row for number in found[session])) > 0
        }
        return lost, wrong


def _abandon(connection):
    """End the transaction of a process that has ended; the file stays as its last commit left it."""
    with contextlib.suppress(sqlite3.Error):
        connection.rollback()


def _rows_of(path):
    """Session of a file and the numbers of its rows."""
    try:
        with contextlib.closing(connect(path)) as connection:
            about = read_about(connection, path)
            blocks = BlockReader(connection, path, about.layout, newest_block(connection)).blocks()
            return about.session, [block.first + n for block in blocks for n in range(block.rows.size)]
    except (sqlite3.Error, PiezodError):
        return "", []
