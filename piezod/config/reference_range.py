"""The range of forces that a reference may ask for: `reference.low_N` to `high_N`, or the force limits."""

from dataclasses import dataclass
from math import inf

from piezod.config.limits import LimitsConfig
from piezod.config.reference import ReferenceConfig, WaveformReference

Bounds = tuple[float | None, float | None]


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


def reference_range(reference: ReferenceConfig, limits: LimitsConfig, readable_N: Bounds) -> ReferenceRange:
    """Make the range of a reference.

    Values of a file, a register or a stream also lie within the force limits. A waveform without keys is bounded by the
    load cell only, so that a reload can tighten the force limits below it.

    Parameters
    ----------
    reference, limits
        Sections of the bench configuration.
    readable_N
        Smallest and largest reading of the load cell [N]; None: unknown.

    Raises
    ------
    ValueError
        A value of a waveform is beyond its bound.
    """
    low, high = (reference.low_N, "reference.low_N"), (reference.high_N, "reference.high_N")
    if isinstance(reference, WaveformReference):
        lows, highs = (low, (readable_N[0], "registers.force.low")), (high, (readable_N[1], "registers.force.high"))
    else:
        lows, highs = (
            (low, (limits.force_min_N, "limits.force_min_N")),
            (high, (limits.force_trip_N, "limits.force_trip_N")),
        )
    low_N, low_key = max(((bound, key) for bound, key in lows if bound is not None), default=(-inf, ""))
    high_N, high_key = min(((bound, key) for bound, key in highs if bound is not None), default=(inf, ""))
    permitted = ReferenceRange(low_N, high_N, low_key, high_key)
    if isinstance(reference, WaveformReference):
        for sign in (1, -1):
            value_N = reference.offset_N + sign * reference.amplitude_N
            if refusal := permitted.refusal(value_N):
                name = f"reference.offset_N {'+' if sign > 0 else '-'} amplitude_N"
                raise ValueError(f"{name} is {value_N:g}, must be {refusal}")
    return permitted
