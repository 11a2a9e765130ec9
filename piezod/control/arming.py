"""What must hold before a voltage is written, and the first step that is: it must raise the force."""

import time
from collections.abc import Callable
from math import ceil, isfinite, isnan

from piezod.config import ArmingConfig, BenchConfig, SignCheckConfig
from piezod.errors import CheckFailedError
from piezod.transport import ExchangeResult, Link, verify_identity

MOST_LOOKS = 20  # for one new sample
FEWEST_SAMPLES = 4  # that a force is averaged over, whatever the rate


def check_ready(bench: BenchConfig, link: Link, sleep: Callable[[float], None] = time.sleep) -> None:
    """Identity, map version, two readings that agree, rest, and a device watchdog that reads back; writes no voltage.

    Parameters
    ----------
    bench
        What must hold.
    link
        Opened.
    sleep
        Lets seconds pass.

    Raises
    ------
    CheckFailedError
        Names what does not hold.
    IdentityError
        Another device, map or byte order than configured.
    TemporaryError
        The device does not answer.
    """
    check_named(bench)
    verify_identity(link)
    first_N = _force_at_rest(bench, link)
    _await_another_sample(bench, link, sleep)
    second_N = _force_at_rest(bench, link)
    span_N = bench.limits.force_trip_N - bench.limits.force_min_N
    within_N = bench.arming.agree_within_N or 0.05 * span_N
    if abs(second_N - first_N) > within_N:
        raise CheckFailedError(
            f"arming: two force readings are {first_N:.3g} N and {second_N:.3g} N, must agree within "
            f"{within_N:.3g} N; check load cell and cable"
        )
    _check_at_rest(bench.arming, link.reading.voltage_readback_V, bench.limits.voltage_safe_V)
    _set_device_watchdog(bench, link)


def check_named(bench: BenchConfig) -> None:
    """Refuse a bench that cannot be checked before it is armed, unless the configuration says that it must go without.

    Raises
    ------
    CheckFailedError
        Names the precondition.
    """
    without = bench.arming.without
    consequence = {
        "identity": "another device would not be noticed",
        "map_version": "another firmware would not be noticed",
        "voltage_readback": "a wrong output would not be noticed",
    }
    for role, noticed in consequence.items():
        named = bench.names(role) if role == "voltage_readback" else bench.link.names(role)
        if role not in without and not named:
            raise CheckFailedError(
                f"arming: the link names no {role}, so {noticed}; name it, or list it in arming.without"
            )
    if "device_watchdog" not in without and bench.limits.device_watchdog_ms == 0:
        raise CheckFailedError(
            "arming: limits.device_watchdog_ms is 0, must be above 0: the output would stay on when this machine dies; "
            "set it, or list device_watchdog in arming.without"
        )


def _await_another_sample(bench: BenchConfig, link: Link, sleep: Callable[[float], None]) -> None:
    """Two readings of the same sample agree however broken the load cell is."""
    before = link.reading.heartbeat
    for _ in range(MOST_LOOKS):
        sleep(bench.dt_s)
        if not link.has("heartbeat"):
            return
        if link.poll() == ExchangeResult.OK and link.reading.heartbeat != before:
            return
    raise CheckFailedError(
        f"arming: {link.description}: heartbeat stands at {before} for {MOST_LOOKS} ticks; does the device sample?"
    )


def _check_at_rest(arming: ArmingConfig, readback_V: float, safe_V: float) -> None:
    if isnan(readback_V):  # there is none, and the configuration says so
        return
    if not isfinite(readback_V) or abs(readback_V - safe_V) > arming.readback_within_V:
        raise CheckFailedError(
            f"arming: the amplifier reads back {readback_V:.3g} V, must be within "
            f"{arming.readback_within_V:g} V of {safe_V:g} V; bring it down first (piezod stop CONFIG --direct)"
        )


def _force_at_rest(bench: BenchConfig, link: Link) -> float:
    for _ in range(5):
        if (result := link.poll()) == ExchangeResult.OK:
            break
    else:
        raise CheckFailedError(
            f"arming: {link.description} gives no good reading: {result.name.lower().replace('_', ' ')}"
        )
    force_N = link.reading.force_N
    if not bench.limits.force_min_N <= force_N <= bench.limits.force_trip_N:
        raise CheckFailedError(
            f"arming: force is {force_N:.3g} N at rest, must be within limits.force_min_N, "
            f"{bench.limits.force_min_N:g}, and limits.force_trip_N, {bench.limits.force_trip_N:g}; check preload, tare"
        )
    return force_N


def _set_device_watchdog(bench: BenchConfig, link: Link) -> None:
    wanted_ms = bench.limits.device_watchdog_ms
    if wanted_ms == 0:
        return
    link.write_register("watchdog_ms", wanted_ms)
    found_ms = link.read_register("watchdog_ms")
    if found_ms != wanted_ms:
        raise CheckFailedError(
            f"arming: the device's watchdog reads back {found_ms:g} ms after {wanted_ms} ms were written; "
            "without it the output stays on when this machine dies"
        )


class SignCheck:
    """A small step up from rest: the mean force must rise with it; then back to rest.

    Parameters
    ----------
    config
        Step, rise and time.
    dt_s
        Tick period [s].
    converter_step_V
        The output comes only so near to what is wished [V].

    Attributes
    ----------
    done
        Passed, and back at rest.
    rise_N
        What the step raised the force by [N].
    """

    __slots__ = (
        "_base_N",
        "_base_V",
        "_config",
        "_count",
        "_near_V",
        "_sum_N",
        "_ticks",
        "_window",
        "done",
        "passed",
        "rise_N",
    )

    def __init__(self, config: SignCheckConfig, dt_s: float, converter_step_V: float = 0.0) -> None:
        self._config = config
        self._near_V = max(0.1 * config.step_V, converter_step_V)
        self._window = max(FEWEST_SAMPLES, ceil(config.settle_s / dt_s))
        self.start(0.0)

    def start(self, base_V: float) -> None:
        """Begin at rest, at `base_V`."""
        self._base_V, self._base_N = base_V, 0.0
        self._ticks = self._count = 0
        self._sum_N = self.rise_N = 0.0
        self.done = self.passed = False

    def wish(self, applied_V: float) -> float:
        """Voltage for this tick [V]: rest, step, rest again."""
        if self._ticks < self._window or self.passed:
            self.done = self.passed and abs(applied_V - self._base_V) <= self._near_V
            return self._base_V
        return self._base_V + self._config.step_V

    def take(self, force_N: float, applied_V: float) -> bool:
        """Take a good reading; False when the step is over and the force has not risen."""
        stepped = self._ticks >= self._window
        if self.passed or (stepped and abs(applied_V - self._base_V - self._config.step_V) > self._near_V):
            return True  # on the way back, or up
        self._ticks += 1
        at = self._ticks - self._window if stepped else self._ticks
        if 2 * at > self._window:  # the first half is for settling
            self._sum_N += force_N
            self._count += 1
        if at < self._window:
            return True
        mean_N, self._sum_N, self._count = self._sum_N / self._count, 0.0, 0
        if not stepped:
            self._base_N = mean_N
            return True
        self.rise_N = mean_N - self._base_N
        self.passed = self.rise_N >= self._config.rise_N
        return self.passed
