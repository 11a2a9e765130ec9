"""Recordings: a time axis and named channels with units, and the files they live in."""

from piezod.recording.csv import read_csv, write_csv
from piezod.recording.recording import TIME, Recording

__all__ = ["TIME", "Recording", "read_csv", "write_csv"]
