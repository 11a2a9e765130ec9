"""References: the force to follow, from a table, a register of the device, or a stream of datagrams."""

from piezod.control.references.counts import ValueResult, counts_dict
from piezod.control.references.file_table import file_table
from piezod.control.references.live import LiveReference
from piezod.control.references.make import make_reference
from piezod.control.references.reference import Freshness, Reference
from piezod.control.references.register import RegisterValue
from piezod.control.references.stream import DatagramStream
from piezod.control.references.table import TableReference, waveform_table

__all__ = [
    "DatagramStream",
    "Freshness",
    "LiveReference",
    "Reference",
    "RegisterValue",
    "TableReference",
    "ValueResult",
    "counts_dict",
    "file_table",
    "make_reference",
    "waveform_table",
]
