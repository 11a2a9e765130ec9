"""Database files."""

import sqlite3

connect = sqlite3.connect
"""Open a database file, as `sqlite3.connect`."""
