"""False alarms and delay of the drift watch, beside the rule of two windows beyond three times the model's error.

python -m tests.studies drift_alarm [--days 1000]

Windows are drawn, not ticks. A drawn window has the noise of its samples and a misfit of the model that depends on the
kind of work.
"""

import argparse
import time
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.config.sections import DriftConfig
from piezod.daemon.drift.blocks import Block
from piezod.daemon.drift.law_test import BlockResult, LawTest
from piezod.daemon.drift.reference import BlockReference
from tests.studies.drift_windows import alarms_at

Array = NDArray[np.float64]

RANGE_V = (0.0, 140.0)
NOMINAL_DAYS, REPEATS = 100.0, 100
WINDOW_S, DAY_S = 10.0, 86400.0
WINDOWS_A_DAY = round(DAY_S / WINDOW_S)
NOISE_N, OWN_N = 0.1, 0.12  # noise, and held-out error of the model
SAMPLES = 2000  # independent ones of the noise in a window: 10,000 at 1 kHz, coloured


@dataclass(frozen=True)
class Kind:
    """Kind of work.

    Parameters
    ----------
    rate_V_per_s
        Rms rate; one power of two for each kind.
    misfit_N
        Median rms misfit of the model in it [N].
    spread
        Standard deviation of the misfit's logarithm, from window to window; it has the tails of Student's t with 5.
    """

    rate_V_per_s: float
    misfit_N: float
    spread: float


KINDS = (
    Kind(1.5, 0.00, 0.02),
    Kind(3.0, 0.05, 0.05),
    Kind(6.0, 0.08, 0.10),
    Kind(12.0, 0.10, 0.10),
    Kind(24.0, 0.15, 0.20),
    Kind(48.0, 0.20, 0.30),
)
FASTER = Kind(384.0, 0.50, 0.10)
"""Another input: the model has no law for this rate and is five noises away. The bench is as it was."""
SLOW = 0.02  # amplitude of the noise's change over day and night
WANDER_N, HOURS = 0.03, 1.0  # standard deviation of the mean difference, and its time constant [h]


@dataclass(frozen=True)
class Work:
    """Work of a bench.

    Parameters
    ----------
    slow
        Amplitude of the noise's change over day and night [1].
    wander_N
        Standard deviation of the mean difference, which changes within the hour [N].
    """

    kinds: tuple[Kind, ...] = KINDS
    slow: float = SLOW
    wander_N: float = WANDER_N


USUAL, EXCHANGEABLE = Work(), Work(slow=0.0, wander_N=0.0)


@dataclass(frozen=True)
class Drawn:
    """Consecutive windows of one drive: rms and mean difference [N], and place of their kind, each shape (N,)."""

    rms_N: Array
    mean_N: Array
    places: NDArray[np.int64]


def draw(random: np.random.Generator, count: int, work: Work = USUAL, begun: int = 0) -> Drawn:
    """Draw windows of one drive, a kind of work for 5 to 60 minutes each."""
    kinds = work.kinds
    places = np.empty(count, np.int64)
    at = 0
    while at < count:
        length = int(random.integers(30, 361))
        places[at : at + length] = random.integers(len(kinds))
        at += length
    misfit_N = np.array([kind.misfit_N for kind in kinds])[places]
    spread = np.array([kind.spread for kind in kinds])[places]
    misfit_N = misfit_N * np.exp(spread * random.standard_t(5, count) * np.sqrt(3.0 / 5.0))
    slow = 1.0 + work.slow * np.sin(2.0 * np.pi * (begun + np.arange(count)) / WINDOWS_A_DAY)
    noise_N2 = (NOISE_N * slow) ** 2 * random.chisquare(SAMPLES, count) / SAMPLES
    rms_N = np.sqrt(noise_N2 + misfit_N**2)
    keeps = np.exp(-WINDOW_S / (3600.0 * HOURS))
    steps_N = work.wander_N * np.sqrt(1.0 - keeps**2) * random.standard_normal(count)
    return Drawn(rms_N, _wander(steps_N, keeps), places)


def windows(random: np.random.Generator, count: int, work: Work = USUAL, begun: int = 0) -> list[Block]:
    """Drawn windows as the daemon has them."""
    drawn = draw(random, count, work, begun)
    rates = [work.kinds[place].rate_V_per_s for place in drawn.places]
    return [
        Block(rms, mean, 0.0, 140.0, rate, rate / 300.0, 20.0)
        for rms, mean, rate in zip(drawn.rms_N.tolist(), drawn.mean_N.tolist(), rates, strict=True)
    ]


def _wander(steps: Array, keeps: float) -> Array:
    """First-order autoregression of these steps, from 0."""
    result, value = np.empty(steps.size), 0.0
    for k, step in enumerate(steps.tolist()):
        value = keeps * value + step
        result[k] = value
    return result


class OldRule:
    """Two windows in a row whose rms or offset is beyond three times the model's own error."""

    def __init__(self) -> None:
        self._above = 0

    def add(self, block: Block, offset_N: float) -> bool:
        """Whether this window is an alarm; the rule then begins again."""
        self._above = self._above + 1 if max(block.rms_N, abs(offset_N)) > 3.0 * OWN_N else 0
        if self._above < 2:
            return False
        self._above = 0
        return True


@dataclass
class Alarms:
    """Number of alarms, and of windows whose input was not compared."""

    new: int = 0
    old: int = 0
    outside: int = 0
    windows: int = 0


def new_test(days: float, tolerance: float) -> LawTest:
    """A test without known windows, at one false alarm in `days`."""
    return LawTest(BlockReference(RANGE_V, OWN_N, tolerance), 3.0 * OWN_N, days * WINDOWS_A_DAY)


def drives(random: np.random.Generator, count: int) -> Iterator[tuple[int, int]]:
    """Begin and number of windows of drives of 1 to 12 hours, `count` windows together."""
    begun = 0
    while begun < count:
        length = min(int(random.integers(360, 4321)), count - begun)
        yield begun, length
        begun += length


def run_unchanged(random: np.random.Generator, test: LawTest, count: int, work: Work = USUAL) -> Alarms:
    """Alarms of both rules over windows without a change of the law."""
    alarms, old = Alarms(), OldRule()
    for begun, length in drives(random, count):
        drive = windows(random, length, work, begun)
        first_N = drive[0].mean_N
        for block in drive:
            offset_N = block.mean_N - first_N
            tested = test.add(block, offset_N)
            alarms.new += tested.alarm
            alarms.outside += tested.result is BlockResult.OUTSIDE
            alarms.old += old.add(block, offset_N)
            alarms.windows += 1
    return alarms


def count_alarms(
    random: np.random.Generator, count: int, work: Work, level: float, tolerance: float
) -> tuple[int, int]:
    """Alarms of new and old rule over windows without a change, with the compiled rank test."""
    distances, places, old = [], [], 0
    for begun, length in drives(random, count):
        drawn = draw(random, length, work, begun)
        offset_N = np.abs(drawn.mean_N - drawn.mean_N[0])
        distances.append(np.hypot(drawn.rms_N, np.maximum(offset_N - OWN_N, 0.0)) / OWN_N)
        places.append(drawn.places)
        old += _old_alarms(np.maximum(drawn.rms_N, offset_N) > 3.0 * OWN_N)
    found = alarms_at(np.concatenate(distances), np.concatenate(places), len(work.kinds), level, tolerance)
    return len(found), old


def _old_alarms(above: NDArray[np.bool_]) -> int:
    """Alarms of the old rule: each second window of a row of windows above."""
    ends = np.flatnonzero(np.diff(np.concatenate(([0], above.astype(np.int8), [0]))))
    return int(((ends[1::2] - ends[::2]) // 2).sum())


def delays_s(
    random: np.random.Generator, known: BlockReference, days: float, added_N: float, kind: Kind
) -> tuple[float, float]:
    """Times from a change to the alarms of new and old rule [s]; inf after an hour without one.

    From a random time of a window on, an error of `added_N` rms is added. `known` is not changed.
    """
    test, old = LawTest(deepcopy(known), 3.0 * OWN_N, days * WINDOWS_A_DAY), OldRule()
    drive, begun, part = windows(random, 460, Work((kind,))), 100, float(random.uniform())
    first_N, found = drive[0].mean_N, [np.inf, np.inf]
    for k, block in enumerate(drive):
        share = 0.0 if k < begun else 1.0 - part if k == begun else 1.0
        changed = replace(block, rms_N=float(np.sqrt(block.rms_N**2 + share * added_N**2)))
        offset_N = block.mean_N - first_N
        alarms = test.add(changed, offset_N).alarm, old.add(changed, offset_N)
        for rule, alarm in enumerate(alarms):
            if alarm and k >= begun:
                found[rule] = min(found[rule], WINDOW_S * (k - begun + 1 - part))
    return found[0], found[1]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--days", type=int, default=1000, help="simulated days of driving")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sets", type=int, default=3, help="so many times, each with other windows")
    parser.add_argument(
        "--check", action="store_true", help="compare drawn windows with those of loop and emulated bench"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Print the table."""
    begun_s, count = time.process_time(), options.days * WINDOWS_A_DAY
    random = np.random.default_rng(options.seed)
    tolerance = DriftConfig().tolerance
    print(f"{options.days} days without a change, nominal {options.days / NOMINAL_DAYS:g} alarms: new rule, old rule")
    for name, work, tolerated in (
        ("exchangeable windows, tolerance 0", EXCHANGEABLE, 0.0),
        (f"day and night, wander; tolerance {tolerance:g}", USUAL, tolerance),
    ):
        for _ in range(options.sets):
            new, old = count_alarms(random, count, work, NOMINAL_DAYS * WINDOWS_A_DAY, tolerated)
            print(f"  {name:45} {new:6} {old:8}", flush=True)
    known = new_test(NOMINAL_DAYS, tolerance)
    run_unchanged(random, known, WINDOWS_A_DAY)
    print(
        f"delay of a change of 3 noises after a day of driving [s], {REPEATS} of each: median, 95 %, longest; old rule"
    )
    for days in (NOMINAL_DAYS, DriftConfig().false_alarm_days):
        for kind in KINDS:
            found = np.array([delays_s(random, known.reference, days, 3.0 * NOISE_N, kind) for _ in range(REPEATS)])
            texts = " ".join(
                f"{value:6.0f}" for rule in found.T for value in np.percentile(rule, (50, 95, 100), method="lower")
            )
            usual_N = known.reference.median_N(windows(random, 1, Work((kind,)))[0].cell(RANGE_V))
            print(
                f"  one in {days:g} days, usual error {usual_N / NOISE_N:.1f} noises, spread {kind.spread:.2f}: {texts}"
            )
    other = run_unchanged(random, known, WINDOWS_A_DAY, Work((FASTER,)))
    print(
        f"another input, a day at five noises, no change of the law: {other.new} alarms of the new rule, "
        f"{other.old} of the old; the first {other.outside} windows are called another input"
    )
    print(f"{time.process_time() - begun_s:.0f} s of processor")
