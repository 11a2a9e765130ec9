"""First part of the demo: an emulated bench follows two references, with plain gain and with the inverse model."""

from dataclasses import dataclass

from piezod.commissioning.emulator import real_time_bench
from piezod.config.reference import WaveformReference
from piezod.daemon.run import drive
from piezod.recording import Recording
from piezod.session.assembly import load_bench_and_model
from piezod.session.history import History, OnRows
from piezod.session.task import Outcome, SegmentSpec

REFERENCES = {
    "triangle": WaveformReference(kind="triangle", amplitude_N=110, offset_N=150, frequency_Hz=0.5, duration_s=4.0),
    "multisine": WaveformReference(kind="multisine", amplitude_N=110, offset_N=150, frequency_Hz=0.25, duration_s=4.0),
}
COMPENSATIONS = ("gain", "inverse")


@dataclass(frozen=True)
class DemoResult:
    """Measurements of the demo.

    Parameters
    ----------
    recordings
        Recordings by (reference, compensation).
    """

    recordings: dict[tuple[str, str], Recording]
    history: History
    outcome: Outcome


def run_demo(on_rows: OnRows, segment_names: list[str], *, quick: bool = False) -> DemoResult:
    """Start the emulator, follow every reference with every compensation, and stop.

    Parameters
    ----------
    on_rows
        Called about ten times per second with new rows, for a live line.
    segment_names
        List that receives the names of the segments, in their order, before the first row.
    quick
        Whether to follow the first reference only.

    Raises
    ------
    PiezodError
        The bench did not start, or the session failed.
    """
    references = list(REFERENCES)[: 1 if quick else None]
    keys = [(reference, compensation) for reference in references for compensation in COMPENSATIONS]
    segments = [
        SegmentSpec(f"{reference}, {compensation}", compensation, REFERENCES[reference])
        for reference, compensation in keys
    ]
    segment_names.extend(segment.name for segment in segments)
    with real_time_bench() as (bench, path):
        _, model = load_bench_and_model(path)
        history, outcome = drive(path, bench, model, segments, on_rows, keeps_rows=False)
    recordings = {}
    for number, key in enumerate(keys):
        metadata = {"bench": bench.name, "reference": key[0], "compensation": key[1]}
        recordings[key] = history.recording(number, metadata=metadata)
    return DemoResult(recordings, history, outcome)
