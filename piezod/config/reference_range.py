"""The range of forces that a reference may ask for: `reference.low_N` to `high_N`, or the force limits."""

from dataclasses import dataclass
from math import inf

from piezod.config.checked import require
from piezod.config.limits import LimitsConfig
from piezod.config.reference import ReferenceConfig, WaveformReference


@dataclass(frozen=True)
class ReferenceRange:
    """Permitted forces of a reference.

    Parameters
    ----------
    low_N, high_N
        Bounds, included [N].
    low_key, high_key
        Keys that the bounds come from, for messages.
    """

    low_N: float = -inf
    high_N: float = inf
    low_key: str = "reference.low_N"
    high_key: str = "reference.high_N"

    def refusal(self, value_N: float) -> str:
        """Text of the bound that a force violates, such as `at most reference.high_N, 300`; empty: none.

        Parameters
        ----------
        value_N
            Force [N]; nan violates both bounds.
        """
        if not value_N <= self.high_N:
            return f"at most {self.high_key}, {self.high_N:g}"
        return "" if value_N >= self.low_N else f"at least {self.low_key}, {self.low_N:g}"


def reference_range(reference: ReferenceConfig, limits: LimitsConfig) -> ReferenceRange:
    """Make the range of a reference; a missing bound is the force limit of the bench.

    Parameters
    ----------
    reference, limits
        Sections of the bench configuration.

    Raises
    ------
    ValueError
        A bound, or a value of a waveform, is beyond its limit.
    """
    low_N, high_N = reference.low_N, reference.high_N
    if high_N is not None:
        most = f"at most limits.force_trip_N, {limits.force_trip_N:g}"
        require(high_N <= limits.force_trip_N, "reference.high_N", high_N, most)
    if low_N is not None:
        least = f"at least limits.force_min_N, {limits.force_min_N:g}"
        require(low_N >= limits.force_min_N, "reference.low_N", low_N, least)
    found = ReferenceRange(
        limits.force_min_N if low_N is None else low_N,
        limits.force_trip_N if high_N is None else high_N,
        "limits.force_min_N" if low_N is None else "reference.low_N",
        "limits.force_trip_N" if high_N is None else "reference.high_N",
    )
    if isinstance(reference, WaveformReference):
        for sign, value_N in (
            ("+", reference.offset_N + reference.amplitude_N),
            ("-", reference.offset_N - reference.amplitude_N),
        ):
            if refusal := found.refusal(value_N):
                raise ValueError(f"reference.offset_N {sign} amplitude_N is {value_N:g}, must be {refusal}")
    return found
