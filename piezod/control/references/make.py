"""The choice of a reference from the bench configuration."""

from pathlib import Path

from piezod.config.reference import FileReference, ReferenceConfig, RegisterReference, WaveformReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references.file_table import file_table
from piezod.control.references.reference import Reference
from piezod.control.references.register import RegisterValue
from piezod.control.references.stream import DatagramStream
from piezod.control.references.table import waveform_table
from piezod.transport import Reading


def make_reference(
    config: ReferenceConfig, rate_Hz: float, folder: Path, reading: Reading, allowed: ReferenceRange, *, counted: bool
) -> Reference:
    """Build the reference that the bench configuration names.

    Parameters
    ----------
    config
        Section `reference` of the bench configuration.
    rate_Hz
        Tick rate [Hz].
    folder
        Folder that relative paths start from.
    reading
        Reading of the link, for a reference in a register.
    allowed
        Range of the reference [N].
    counted
        Whether the link reads `reference_counter`.

    Raises
    ------
    ConfigurationError
        A file cannot be read or holds a value beyond the range. A waveform does not fit the tick rate. The path or the
        key of a stream cannot be used.
    BusyError
        The address of the stream is in use.
    """
    if isinstance(config, WaveformReference):
        return waveform_table(config, rate_Hz)
    if isinstance(config, FileReference):
        return file_table(config, rate_Hz, folder, allowed)
    if isinstance(config, RegisterReference):
        return RegisterValue(reading, config, allowed, counted=counted)
    return DatagramStream(config, allowed)
