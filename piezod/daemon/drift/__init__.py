"""The drift watch: whether a running bench still follows its model.

- `watch.py` compares readings and model, window by window, and reports.
- `blocks.py`: the figures of a window.
- `reference.py`: windows that are known, by the kind of their input.
- `law_test.py`: the comparison of a window.
- `alarm.py`: evidence of a change, with a rate of false alarms.
- `files.py`: the recording after a drift, and the known windows.
"""

from piezod.daemon.drift.files import blocks_file, drift_file, find_drift_recording
from piezod.daemon.drift.watch import DriftWatch

__all__ = ["DriftWatch", "blocks_file", "drift_file", "find_drift_recording"]
