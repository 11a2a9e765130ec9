"""One case: a plant, its noise, its records and its active effects."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant import sampling
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.study.catalogue import ONCE, TONES, frozen_spans
from firmware_sim.concealed.study.entry import ALREADY_THERE, COME_SINCE

TEMPERATURE_NOISE_K = 0.01


@dataclass(frozen=True)
class Noise:
    """Noise of the readings.

    Parameters
    ----------
    kind
        `white`, `coloured` or `quantised` (white, rounded to steps much finer than the noise).
    rms_N
        Rms of the noise [N].
    corner_Hz
        Corner frequency of the coloured part [Hz].
    step_N
        Step of the converter [N]; 0: none.
    """

    kind: str
    rms_N: float
    corner_Hz: float
    step_N: float


@dataclass(frozen=True)
class Voltmeter:
    """Instrument of the recorded voltage: gain (1) and rms of its white noise [V]; the stack is not affected."""

    gain: float = 1.0
    noise_V: float = 0.0


EXACT = Voltmeter()


@dataclass(frozen=True)
class Record:
    """One record of a case.

    Parameters
    ----------
    name
        File name.
    seed
        Seed of noise, phases and random walks in this record.
    tare_N
        Offset of the readings [N].
    begin_s
        Time of the first sample that is written [s]; 0: at rest.
    """

    name: str
    drive: Drive
    seed: int
    tare_N: float = 0.0
    begin_s: float = 0.0


@dataclass(frozen=True)
class Case:
    """One case of a study.

    Parameters
    ----------
    kind
        One of `plan.KINDS`.
    plant
        Plant without effects.
    records
        Identification record, one or two recordings of work, held-out record.
    effects
        Active effects, by name.
    shows_temperature
        True: the files have a temperature channel.
    truth
        Description of the case for the sealed truth.
    voltmeter
        Instrument of the recorded voltage.
    """

    kind: str
    plant: Plant
    noise: Noise
    records: tuple[Record, ...]
    effects: Mapping[str, Effect]
    shows_temperature: bool
    truth: dict[str, object]
    voltmeter: Voltmeter = EXACT

    def active(self, record: Record) -> dict[str, Effect]:
        """Active effects of a record; effects in `ONCE` act in the first recording alone."""
        return effects_in(self.effects, record.name)

    def reading_N(self, record: Record) -> Array:
        """Readings with noise, shape (n,) [N]."""
        active = self.active(record)
        rng = np.random.Generator(np.random.PCG64(record.seed + 1))
        count, noise, dropout = record.drive.voltage_V.size, self.noise, active.get("sensor_dropout")
        manner = "" if dropout is None else dropout.details.get("manner", "exact")
        reading = self.plant.reading_N(record.drive, active, record.seed)
        if dropout is not None and manner == "noisy":  # the electronics behind the sensor go on
            reading = sampling.frozen(reading, record.drive.time_s, frozen_spans(dropout))
        reading = reading + sampling.noise(rng, count, noise.rms_N, noise.kind, record.drive.rate_Hz, noise.corner_Hz)
        if on := active.get("quantisation"):
            reading = sampling.quantised(reading, on.parameters["step_N"])
        elif noise.step_N > 0.0:
            reading = sampling.quantised(reading, noise.step_N)
        if dropout is not None and manner != "noisy":
            reading = dropped_out(reading, record.drive.time_s, dropout, self.plant.law.full_N)
        return reading + record.tare_N if record.tare_N else reading

    def recorded_voltage_V(self, record: Record) -> Array:
        """Voltage as the file states it, shape (n,) [V]."""
        rng = np.random.Generator(np.random.PCG64(record.seed + 3))
        stated_V: Array = self.voltmeter.gain * record.drive.voltage_V
        return stated_V + self.voltmeter.noise_V * rng.normal(0.0, 1.0, stated_V.size)

    def repeatable_N(self, record: Record) -> Array:
        """Force without tare, noise, tones, single events and converter steps, shape (n,) [N]."""
        lasting = {name: on for name, on in self.active(record).items() if name not in TONES | ONCE}
        return self.plant.reading_N(record.drive, lasting, record.seed)

    def temperature_C(self, record: Record) -> Array:
        """Readings of the temperature channel, shape (n,) [degC]."""
        rng = np.random.Generator(np.random.PCG64(record.seed + 2))
        return record.drive.temperature_C + TEMPERATURE_NOISE_K * rng.normal(0.0, 1.0, record.drive.voltage_V.size)


def dropped_out(reading_N: Array, time_s: Array, dropout: Effect, full_N: float) -> Array:
    """Readings that stand still, or at the rail, while the sensor drops out, shape (n,) [N].

    Parameters
    ----------
    reading_N, time_s
        Readings and their times, shape (n,) [N, s].
    dropout
        Effect `sensor_dropout`.
    full_N
        Force range of the plant [N].
    """
    spans_s = frozen_spans(dropout)
    if dropout.details.get("manner") == "rail":
        return sampling.at_rail(reading_N, time_s, spans_s, sampling.RAIL * full_N)
    return sampling.frozen(reading_N, time_s, spans_s)


def effects_in(effects: Mapping[str, Effect], record: str) -> dict[str, Effect]:
    """Active effects of the record with a given file name.

    Parameters
    ----------
    effects
        Active effects of the case, by name.
    record
        File name of the record.
    """
    if record.startswith("identification"):
        return {name: on for name, on in effects.items() if on.scope == ALREADY_THERE}
    if record in {"recording.csv", "recording_1.csv"}:
        return dict(effects)
    return {name: on for name, on in effects.items() if name not in ONCE or on.scope != COME_SINCE}
