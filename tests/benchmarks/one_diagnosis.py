"""One diagnosis in a separate process: its duration and the peak memory of the process.

    python -m tests.benchmarks.one_diagnosis FOLDER EFFECTS

FOLDER holds `work.csv`, `model.yaml` and `identification.csv`; of the catalogue only so many EFFECTS are tried.
"""

import json
import sys
from collections.abc import ValuesView
from pathlib import Path
from time import perf_counter, process_time

from piezod.diagnose.candidates import screening, starts
from piezod.diagnose.command import diagnose_files
from piezod.effects import EFFECTS
from piezod.effects.effect import Effect

FIRST = (
    "electrical_lag",
    "creep",
    "resonance",
    "friction",
    "load_step",
    "sensor_filter",
)  # present, then similar


class Cut(dict[str, Effect]):
    """The catalogue, limited to the effects to try."""

    def __init__(self, tried: int) -> None:
        super().__init__(EFFECTS)
        order = [*FIRST, *(name for name in EFFECTS if name not in FIRST)]
        self.tried = {name: effect for name, effect in EFFECTS.items() if name in order[:tried]}

    def values(self) -> ValuesView[Effect]:
        """The effects to try."""
        return self.tried.values()


def main() -> None:
    """Diagnose and print the figures as JSON."""
    folder, tried = Path(sys.argv[1]), int(sys.argv[2])
    screening.EFFECTS = starts.EFFECTS = Cut(tried)
    at_start_MiB = most_resident_MiB()
    begun_s, begun_cpu_s = perf_counter(), process_time()
    found = diagnose_files([folder / "work.csv"], folder / "model.yaml", folder / "out", None, None, lambda *_: None)
    seconds, cpu_s = perf_counter() - begun_s, process_time() - begun_cpu_s
    figures = {
        "seconds": seconds,
        "cpu_s": cpu_s,
        "MiB": most_resident_MiB(),
        "at_start_MiB": at_start_MiB,
        "named": [one.name for one in found.findings.effects],
        "verdict": found.findings.verdict,
    }
    print(json.dumps(figures))


def most_resident_MiB() -> float:
    """Peak memory of this process; `getrusage` would include that of its parent before exec."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    raise OSError("/proc/self/status tells no VmHWM")


if __name__ == "__main__":
    main()
