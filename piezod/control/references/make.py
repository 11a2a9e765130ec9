"""The choice of a reference from the bench configuration."""

from pathlib import Path

from piezod.config.reference import FileReference, ReferenceConfig, RegisterReference, WaveformReference
from piezod.control.references.live import DatagramStream, RegisterValue
from piezod.control.references.reference import Reference
from piezod.control.references.table import file_table, waveform_table
from piezod.transport import Reading


def make_reference(
    config: ReferenceConfig, rate_Hz: float, folder: Path, reading: Reading, *, counted: bool
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
    counted
        Whether the link reads `reference_counter`.

    Raises
    ------
    ConfigurationError
        A file cannot be read, or a waveform does not fit the tick rate.
    BusyError
        The address of the stream is in use.
    """
    if isinstance(config, WaveformReference):
        return waveform_table(config, rate_Hz)
    if isinstance(config, FileReference):
        return file_table(config, rate_Hz, folder)
    if isinstance(config, RegisterReference):
        return RegisterValue(reading, config, counted=counted)
    return DatagramStream(config)
