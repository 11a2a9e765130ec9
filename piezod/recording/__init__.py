"""Recordings: a time axis and named channels with units, and the files that hold them."""

from piezod.recording.files import column_names, open_stream, read_recording, write_recording
from piezod.recording.formats.csv import write_csv
from piezod.recording.formats.text import read_csv
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.recording import TIME, Recording

__all__ = [
    "TIME",
    "Recording",
    "TextOptions",
    "column_names",
    "open_stream",
    "read_csv",
    "read_recording",
    "write_csv",
    "write_recording",
]
