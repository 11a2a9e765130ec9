"""One case: a plant, its noise, its records, the effects that are on."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant import reader
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.passage import Effect
from firmware_sim.concealed.study.catalogue import ONCE, SINCE, THERE, TONES, frozen_places

TEMPERATURE_NOISE_K = 0.01
LATE = ("quantisation", "sensor_dropout")  # what acts on the readings, after the noise


@dataclass(frozen=True)
class Noise:
    """What every reading has.

    Parameters
    ----------
    kind
        `white`, `coloured` or `quantised` (white, on a lattice much finer than itself).
    rms_N
        All of it together [N].
    corner_Hz
        Of the coloured part [Hz].
    step_N
        Of the lattice; 0: none [N].
    """

    kind: str
    rms_N: float
    corner_Hz: float
    step_N: float


@dataclass(frozen=True)
class Record:
    """One record of a case.

    Parameters
    ----------
    name
        Its file.
    drive
        Its commands.
    seed
        Of its noise and of what is random in it.
    """

    name: str
    drive: Drive
    seed: int


@dataclass(frozen=True)
class Case:
    """Everything that a case is.

    Parameters
    ----------
    kind
        `null`, `single`, `pair`, `triple` or `foreign`.
    plant, noise
        Without effects.
    records
        The identification, one or two recordings of work, the held-out one.
    effects
        Those that are on.
    shows_temperature
        The files have a temperature channel.
    truth
        What the sealed truth says besides.
    """

    kind: str
    plant: Plant
    noise: Noise
    records: tuple[Record, ...]
    effects: Mapping[str, Effect]
    shows_temperature: bool
    truth: dict[str, object]

    def active(self, record: Record) -> dict[str, Effect]:
        """Effects that are on in a record; what happens once is in the first recording alone."""
        return effects_in(self.effects, record.name)

    def reading_N(self, record: Record) -> Array:
        """What the reader shows, shape (n,) [N]."""
        active = self.active(record)
        rng = np.random.Generator(np.random.PCG64(record.seed + 1))
        count, noise = record.drive.voltage_V.size, self.noise
        reading = self.plant.reading_N(record.drive, active, record.seed)
        reading = reading + reader.noise(rng, count, noise.rms_N, noise.kind, record.drive.rate_Hz, noise.corner_Hz)
        if on := active.get("quantisation"):
            reading = reader.quantised(reading, on.parameters["step_N"])
        elif noise.step_N > 0.0:
            reading = reader.quantised(reading, noise.step_N)
        if on := active.get("sensor_dropout"):
            reading = reader.frozen(reading, record.drive.time_s, frozen_places(on))
        return reading

    def repeatable_N(self, record: Record) -> Array:
        """Force without noise, tones, one-off events and converter: what a model could say at best, shape (n,) [N]."""
        lasting = {name: on for name, on in self.active(record).items() if name not in TONES | ONCE}
        return self.plant.reading_N(record.drive, lasting, record.seed)

    def temperature_C(self, record: Record) -> Array:
        """The temperature channel, shape (n,) [degC]."""
        rng = np.random.Generator(np.random.PCG64(record.seed + 2))
        return record.drive.temperature_C + TEMPERATURE_NOISE_K * rng.normal(0.0, 1.0, record.drive.voltage_V.size)


def effects_in(effects: Mapping[str, Effect], record: str) -> dict[str, Effect]:
    """Effects that are on in the record of a name."""
    if record.startswith("identification"):
        return {name: on for name, on in effects.items() if on.scope == THERE}
    if record in {"recording.csv", "recording_1.csv"}:
        return dict(effects)
    return {name: on for name, on in effects.items() if name not in ONCE or on.scope != SINCE}
