"""Age of a tick: how long ago its values were true."""

from piezod.runtime import clock

STALE_AFTER_S = 1.0  # age from which values count as stale [s], at a rate of some ticks a second
STALE_TICKS = 3.0  # limit for a slower bench [ticks]


def age_s(time_ns: int) -> float:
    """Age of a row of the ring log [s].

    Parameters
    ----------
    time_ns
        Its `time_ns`, of the clock CLOCK_BOOTTIME [ns].
    """
    return 1e-9 * (clock.boot_ns() - time_ns)


def is_stale(age_s: float | None, dt_s: float) -> bool:
    """Whether values of this age are no present values; True if there are none.

    Parameters
    ----------
    age_s
        Age [s]; None: there is no tick.
    dt_s
        Time between two ticks [s].
    """
    return age_s is None or age_s > max(STALE_AFTER_S, STALE_TICKS * dt_s)
