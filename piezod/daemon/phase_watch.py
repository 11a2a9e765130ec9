"""Durations of the phases of a tick, as the daemon shows them: status, metrics and one warning a phase."""

from collections.abc import Callable
from typing import Any

from piezod.control.phase_times import PHASES, PhaseReader
from piezod.daemon.statistics import BOUNDS_S, DurationHistogram


class PhaseWatch:
    """Histograms of the phases over all sessions.

    Parameters
    ----------
    log
        Called with one line for a phase that lasted longer than `daemon.slow_phase_ms`, once for each session.

    Attributes
    ----------
    histograms
        Histogram of each phase, in the order of `PHASES`.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._logged: set[str] = set()
        self._reader: PhaseReader | None = None
        self._longest_ns = [0] * len(PHASES)
        self.histograms = [DurationHistogram() for _ in PHASES]

    def begin(self, cells: Any) -> None:  # noqa: ANN401  # any object with the buffer protocol
        """Begin a new session with this memory; the sums stay."""
        self._reader = PhaseReader(cells)
        self._logged.clear()

    def add_new(self, slow_ms: float | None) -> None:
        """Add the ticks since the last call.

        Parameters
        ----------
        slow_ms
            Duration of a phase that is logged [ms]; None: none is logged.
        """
        if self._reader is None:
            return
        durations_ns = self._reader.read()
        if not len(durations_ns):
            return
        for k, name in enumerate(PHASES):
            self.histograms[k].add(durations_ns[:, k])
            longest_ns = int(durations_ns[:, k].max())
            self._longest_ns[k] = max(self._longest_ns[k], longest_ns)
            if slow_ms is not None and longest_ns > 1e6 * slow_ms and name not in self._logged:
                self._logged.add(name)
                self._log(
                    f"tick: phase {name} lasted {1e-6 * longest_ns:.2f} ms, daemon.slow_phase_ms is {slow_ms:g}; see "
                    "piezod status --json, piezod latency"
                )

    def as_dict(self) -> dict[str, object]:
        """Bounds [s] of the bins; count of each bin, mean and maximum of each phase, for `piezod status`."""
        return {"bounds_s": BOUNDS_S} | {name: self._phase(k) for k, name in enumerate(PHASES)}

    def _phase(self, k: int) -> dict[str, object]:
        histogram = self.histograms[k]
        ticks = int(histogram.counts.sum())
        return {
            "counts": histogram.counts.tolist(),
            "mean_us": round(1e6 * histogram.sum_s / ticks, 2) if ticks else None,
            "max_us": round(1e-3 * self._longest_ns[k], 2) if ticks else None,
        }
