"""The bench of a case: ranges, rate, records, voltmeter. It is drawn as usual, or varied as laboratories vary.

A usual bench begins every record at rest, identifies by slow triangles, works by mixed work, and records its commands.
A varied bench draws each of these, a tare for every record, and a voltmeter with noise and a gain error. Its kind of
identification and its kind of work hold for all of its records.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive, identification_voltage, mixed_work, temperature
from firmware_sim.concealed.plant.identification_drives import AMID, IDENTIFICATIONS, Commands
from firmware_sim.concealed.plant.work_drives import WORKS, driven_work
from firmware_sim.concealed.study.case import EXACT, Record, Voltmeter

RATES_HZ = (200.0, 250.0, 500.0, 1000.0, 2000.0)
RATE_SHARES = (0.1, 0.1, 0.3, 0.4, 0.1)
DURATIONS_S, DURATION_SHARES = (30.0, 60.0, 120.0), (0.15, 0.7, 0.15)
RATE_LIMITED_SHARE = 0.5  # of the benches limit the rate of their commands
RATE_LIMIT = (1.0, 40.0)  # [ranges per second]
READ_LATE = (0.35, 0.9)  # time from a held command to its reading [samples]

VARIED_RATES_HZ = (250.0, 500.0, 1000.0, 1200.0, 2000.0, 2048.0, 5000.0, 9600.0, 10_000.0)
VARIED_RATE_SHARES = (0.12, 0.18, 0.2, 0.08, 0.12, 0.08, 0.08, 0.06, 0.08)
MOST_ROWS = 120_000
AMID_SHARE = 1.0 / 3.0  # of the varied benches begin to write the work amid the range
MOST_TARE = 0.5  # [full force]
VOLTMETER_NOISE = (0.0002, 0.002)  # rms [range]
VOLTMETER_GAIN = 0.005  # largest error of the gain [1]


@dataclass(frozen=True)
class Bench:
    """Ranges, records and voltmeter of a case.

    Parameters
    ----------
    rate_Hz
        Rate of commands and readings [1/s].
    reach_V, full_N
        Ranges of voltage [V] and force [N].
    held
        Whether a command is held until the next.
    late
        Time from a held command to its reading [samples].
    most_V_per_s
        Highest rate of change of the commands [V/s]; infinite: no limit.
    records
        Identification record, one or two recordings of work, held-out record.
    voltmeter
        Instrument of the recorded voltage.
    truth
        Further drawn choices, for the sealed truth; empty for a usual bench.
    """

    rate_Hz: float
    reach_V: float
    full_N: float
    held: bool
    late: float
    most_V_per_s: float
    records: tuple[Record, ...] = ()
    voltmeter: Voltmeter = EXACT
    truth: dict[str, object] = field(default_factory=dict)


def draw_bench(rng: np.random.Generator, *, straight: bool) -> Bench:
    """Draw a usual bench; `straight`: its commands are not held."""
    bench = _ranges(rng, RATES_HZ, RATE_SHARES, straight=straight)
    drawn_s = [float(rng.choice(DURATIONS_S, p=DURATION_SHARES)) for _ in range(2)]
    most_s = 60.0 if bench.rate_Hz > 1000.0 else 120.0
    records = []
    for name, duration_s in _durations(rng, min(rng.uniform(40.0, 120.0), most_s), drawn_s, most_s):
        if name.startswith("identification"):
            voltage_V = identification_voltage(rng, bench.reach_V, bench.rate_Hz, duration_s)
        else:
            voltage_V = mixed_work(rng, bench.reach_V, bench.rate_Hz, duration_s, bench.most_V_per_s)
        records.append(_record(rng, name, bench, voltage_V, duration_s))
    return replace(bench, records=tuple(records))


def draw_varied_bench(rng: np.random.Generator, *, straight: bool) -> Bench:
    """Draw a varied bench; `straight`: its commands are not held."""
    bench = _ranges(rng, VARIED_RATES_HZ, VARIED_RATE_SHARES, straight=straight)
    noise_V = bench.reach_V * float(np.exp(rng.uniform(*np.log(VOLTMETER_NOISE))))
    voltmeter = Voltmeter(1.0 + rng.uniform(-VOLTMETER_GAIN, VOLTMETER_GAIN), noise_V)
    identification, work = str(rng.choice(list(IDENTIFICATIONS))), str(rng.choice(list(WORKS)))
    amid_identification, amid_work = identification in AMID and bool(rng.random() < 0.5), rng.random() < AMID_SHARE
    most_s = MOST_ROWS / bench.rate_Hz
    drawn_s = [float(rng.choice(DURATIONS_S, p=DURATION_SHARES)) for _ in range(2)]
    records = []
    for name, duration_s in _durations(rng, min(rng.uniform(20.0, 120.0), most_s), drawn_s, most_s):
        amid = False  # the held-out record begins at rest: its start must be known for a simulation
        if name.startswith("identification"):
            commands, amid = IDENTIFICATIONS[identification](rng, bench.rate_Hz, duration_s), amid_identification
        else:
            limit = bench.most_V_per_s / bench.reach_V
            commands = driven_work(work, rng, bench.rate_Hz, duration_s, limit)
            amid = bool(amid_work) and name.startswith("recording")
        records.append(_varied_record(rng, name, bench, commands, amid=amid))
    truth: dict[str, object] = {
        "identification": identification,
        "work": work,
        "voltmeter": {"gain": voltmeter.gain, "noise_V": voltmeter.noise_V},
        "tares_N": {record.name: record.tare_N for record in records},
        "begins_s": {record.name: record.begin_s for record in records},
    }
    return replace(bench, records=tuple(records), voltmeter=voltmeter, truth=truth)


def _ranges(
    rng: np.random.Generator, rates_Hz: tuple[float, ...], shares: tuple[float, ...], *, straight: bool
) -> Bench:
    rate_Hz = float(rng.choice(rates_Hz, p=shares))
    reach_V = round(rng.uniform(60.0, 200.0), 1)
    full_N = float(np.exp(rng.uniform(np.log(50.0), np.log(2000.0))))
    held = bool(rng.random() < 0.5) and not straight
    late = rng.uniform(*READ_LATE) if held else 0.0
    limited = bool(rng.random() < RATE_LIMITED_SHARE)
    most_V_per_s = reach_V * (float(np.exp(rng.uniform(*np.log(RATE_LIMIT)))) if limited else np.inf)
    return Bench(rate_Hz, reach_V, full_N, held, late, most_V_per_s)


def _durations(
    rng: np.random.Generator, identification_s: float, drawn_s: list[float], most_s: float
) -> Iterator[tuple[str, float]]:
    """Names and durations [s] of the records; a third of the benches has two recordings of work.

    That share is drawn after the first record, so that a seed keeps its study.
    """
    yield "identification.csv", identification_s
    if rng.random() < 1.0 / 3.0:
        yield from ((f"recording_{k}.csv", min(drawn_s[0], 60.0, most_s)) for k in (1, 2))
    else:
        yield "recording.csv", min(drawn_s[0], most_s)
    yield "held_out.csv", min(drawn_s[1], most_s)


def _record(rng: np.random.Generator, name: str, bench: Bench, voltage_V: Array, duration_s: float) -> Record:
    voltage_V = np.asarray(np.round(voltage_V, 4), dtype=np.float64)
    warmth = temperature(rng, duration_s, bench.rate_Hz)[: voltage_V.size]
    return Record(name, Drive(voltage_V, bench.rate_Hz, bench.held, bench.late, warmth), int(rng.integers(2**40)))


def _varied_record(rng: np.random.Generator, name: str, bench: Bench, commands: Commands, *, amid: bool) -> Record:
    duration_s = (commands.levels.size + 1) / bench.rate_Hz
    record = _record(rng, name, bench, bench.reach_V * commands.levels, duration_s)
    begin_s = commands.lead / bench.rate_Hz if amid else 0.0
    return replace(record, begin_s=begin_s, tare_N=bench.full_N * rng.uniform(-MOST_TARE, MOST_TARE))
