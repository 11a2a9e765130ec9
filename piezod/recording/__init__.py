"""Recordings: a time axis and named channels with units, and the files that hold them."""

from piezod.recording.conversion import choose_columns
from piezod.recording.files import (
    check_output_path,
    check_recording_target,
    column_names,
    convert,
    open_stream,
    read_recording,
    write_recording,
)
from piezod.recording.formats.csv import write_csv
from piezod.recording.formats.strict_csv import StrictTable, read_strict_csv
from piezod.recording.formats.text import read_csv
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.hold import HELD_ONE_SAMPLE, Hold
from piezod.recording.recording import TIME, Recording
from piezod.recording.targets import check_absent, check_folder, check_model_target, check_page

__all__ = [
    "HELD_ONE_SAMPLE",
    "TIME",
    "Hold",
    "Recording",
    "StrictTable",
    "TextOptions",
    "check_absent",
    "check_folder",
    "check_model_target",
    "check_output_path",
    "check_page",
    "check_recording_target",
    "choose_columns",
    "column_names",
    "convert",
    "open_stream",
    "read_csv",
    "read_recording",
    "read_strict_csv",
    "write_csv",
    "write_recording",
]
