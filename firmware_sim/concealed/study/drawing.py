"""Draws a case: ranges, records, plant, noise, and effects of the strengths wanted."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive, identification_voltage, mixed_work, temperature
from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.plant.hysteresis import Kind, draw_hysteresis, draw_noncongruent
from firmware_sim.concealed.plant.mechanics import ForceLaw
from firmware_sim.concealed.plant.passage import Effect
from firmware_sim.concealed.plant.reader import frozen, quantised
from firmware_sim.concealed.study.case import Case, Noise, Record, effects_in
from firmware_sim.concealed.study.catalogue import ENTRIES, RAMP_SAMPLES, SINCE, Context, Entry, frozen_places, places
from firmware_sim.concealed.study.strength import Visible, find_scale

STRENGTHS = (0.8, 4.0, 20.0)
RATES_HZ = (200.0, 250.0, 500.0, 1000.0, 2000.0)
RATE_SHARES = (0.1, 0.1, 0.3, 0.4, 0.1)
DURATIONS_S, DURATION_SHARES = (30.0, 60.0, 120.0), (0.15, 0.7, 0.15)
NOISE_SHARES = {"white": 0.45, "coloured": 0.3, "quantised": 0.25}
LEAST_NOISE, MOST_NOISE = 0.0002, 0.003  # of the range
FINE_STEP = (0.05, 0.35)  # of the noise: an ordinary converter
MISFIT = 0.12  # of the noise: what plays may leave of a hysteresis that counts as one they can follow
SHOWN_TOGETHER = 0.5  # of its own strength: what an effect must still show beside the others
GENTLE = 0.5  # of the benches limit the rate of their commands
GENTLE_PACE = (1.0, 40.0)  # to so many ranges a second
READ_LATE = (0.35, 0.9)  # of a sample: how long after a command that is held its reading is taken
FOREIGNNESS = 0.25  # of what a foreign effect does, that its neighbours in the catalogue may not be able to do
ATTEMPTS = 18
STRICT = 8  # attempts before a strength other than the one wanted is taken


@dataclass(frozen=True)
class Wish:
    """What is to be drawn.

    Parameters
    ----------
    kind
        `null`, `single`, `pair`, `triple` or `foreign`.
    names
        Effects that are to be on; of a foreign case, the foreign one first.
    strengths
        Of each, in parts of the noise; another is taken where this one is not plausible.
    noise
        `white`, `coloured` or `quantised`.
    """

    kind: str
    names: tuple[str, ...]
    strengths: tuple[float, ...]
    noise: str


def draw_case(wish: Wish, seed: np.random.SeedSequence) -> Case:
    """Draw a case; a draw that turns out implausible is thrown away and drawn again.

    Raises
    ------
    RuntimeError
        No draw was plausible.
    """
    for attempt, child in enumerate(seed.spawn(ATTEMPTS)):
        case = _Draw(wish, np.random.Generator(np.random.PCG64(child)), strict=attempt < STRICT).case()
        if case is not None:
            return case
    raise RuntimeError(f"{wish.kind} {'+'.join(wish.names)}: no plausible case in {ATTEMPTS} attempts")


class _Draw:
    """One attempt."""

    def __init__(self, wish: Wish, rng: np.random.Generator, *, strict: bool) -> None:
        self._wish, self._rng, self._strict = wish, rng, strict
        self._rate_Hz = float(rng.choice(RATES_HZ, p=RATE_SHARES))
        self._reach_V = round(rng.uniform(60.0, 200.0), 1)
        self._full_N = float(np.exp(rng.uniform(np.log(50.0), np.log(2000.0))))
        self._held = bool(rng.random() < 0.5) and not any(ENTRIES[n].straight for n in wish.names if n in ENTRIES)
        self._late = rng.uniform(*READ_LATE) if self._held else 0.0
        gentle = bool(rng.random() < GENTLE)
        self._most_V_per_s = self._reach_V * (float(np.exp(rng.uniform(*np.log(GENTLE_PACE)))) if gentle else np.inf)
        self._records = self._draw_records()
        self._work = next(record for record in self._records if record.name.startswith("recording"))
        self._plant = self._draw_plant()
        self._noise = self._draw_noise()

    def case(self) -> Case | None:
        if self._misfit_N() > MISFIT * self._noise.rms_N * 1.01:
            return None
        drive = self._work.drive
        u = drive.voltage_V
        fastest, lasting = (float(np.abs(u[n:] - u[:-n]).max()) / n * self._rate_Hz for n in (1, RAMP_SAMPLES))
        context = Context(
            self._reach_V, self._full_N, self._rate_Hz, self._noise.rms_N, float(drive.time_s[-1]), fastest, lasting
        )
        plain = self._reading(self._work, {})
        visible = Visible(plain, drive.voltage_V, self._rate_Hz)
        effects: dict[str, Effect] = {}
        truths: list[dict[str, object]] = []
        for name, strength in zip(self._wish.names, self._wish.strengths, strict=True):
            found = self._effect(name, strength, context, visible)
            if found is None:
                return None
            effects[name], truth = found
            truths.append(truth)
        if not self._all_show(effects, truths):
            return None
        return self._assembled(effects, truths)

    def _assembled(self, effects: Mapping[str, Effect], truths: Sequence[dict[str, object]]) -> Case:
        shows = "thermal_drift" in effects or bool(self._rng.random() < 0.2)
        truth: dict[str, object] = {
            "kind": self._wish.kind,
            "effects": list(truths),
            "noise": asdict(self._noise),
            "hysteresis": {
                "kind": self._plant.hysteresis.kind,
                "irreversible": self._plant.hysteresis.irreversible,
                "misfit_in_noise": self._misfit_N() / self._noise.rms_N,
            },
            "force_law": asdict(self._plant.law),
            "reach_V": self._reach_V,
            "rate_Hz": self._rate_Hz,
            "held": self._held,
            "read_late_samples": self._late,
        }
        return Case(self._wish.kind, self._plant, self._noise, self._records, effects, shows, truth)

    def _draw_records(self) -> tuple[Record, ...]:
        rng, rate_Hz = self._rng, self._rate_Hz
        drawn_s = [float(rng.choice(DURATIONS_S, p=DURATION_SHARES)) for _ in range(2)]
        most_s = 60.0 if rate_Hz > 1000.0 else 120.0
        identification_s = min(rng.uniform(40.0, 120.0), most_s)
        records = [self._record("identification.csv", identification_s)]
        if rng.random() < 1.0 / 3.0:
            records += [self._record(f"recording_{k}.csv", min(drawn_s[0], 60.0)) for k in (1, 2)]
        else:
            records.append(self._record("recording.csv", min(drawn_s[0], most_s)))
        records.append(self._record("held_out.csv", min(drawn_s[1], most_s)))
        return tuple(records)

    def _record(self, name: str, duration_s: float) -> Record:
        if name.startswith("identification"):
            voltage_V = identification_voltage(self._rng, self._reach_V, self._rate_Hz, duration_s)
        else:
            voltage_V = mixed_work(self._rng, self._reach_V, self._rate_Hz, duration_s, self._most_V_per_s)
        voltage_V = np.round(voltage_V, 4)
        warmth = temperature(self._rng, duration_s, self._rate_Hz)[: voltage_V.size]
        return Record(
            name, Drive(voltage_V, self._rate_Hz, self._held, self._late, warmth), int(self._rng.integers(2**40))
        )

    def _draw_plant(self) -> Plant:
        rng = self._rng
        kinds: tuple[Kind, ...] = ("preisach", "plays", "bouc_wen")
        shares = (0.45, 0.35, 0.2)
        if "rate_dependent_hysteresis" in self._wish.names:
            kinds, shares = ("plays", "plays", "bouc_wen"), (0.4, 0.3, 0.3)
        core = draw_hysteresis(rng, kinds[int(rng.choice(3, p=shares))], self._reach_V)
        law = ForceLaw(self._full_N, rng.uniform(-0.2, 0.25), rng.uniform(-0.06, 0.12))
        return Plant(core, draw_noncongruent(rng, self._reach_V), law)

    def _draw_noise(self) -> Noise:
        rng, kind = self._rng, self._wish.noise
        least = min(max(LEAST_NOISE, self._misfit_N() / self._full_N / MISFIT), MOST_NOISE)
        rms_N = self._full_N * float(np.exp(rng.uniform(np.log(least), np.log(MOST_NOISE))))
        step_N = rms_N * rng.uniform(*FINE_STEP) if kind == "quantised" else 0.0
        return Noise(kind, rms_N, float(np.exp(rng.uniform(np.log(0.5), np.log(20.0)))), step_N)

    def _misfit_N(self) -> float:
        """What superposed plays leave of the hysteresis without effects, on the first recording [N]."""
        voltage_V = self._work.drive.voltage_V
        stroke = self._plant.hysteresis.run(voltage_V)
        return Visible(voltage_V, voltage_V, self._rate_Hz).after_refit_N(stroke) / self._reach_V * self._full_N

    def _reading(self, record: Record, effects: Mapping[str, Effect]) -> Array:
        """Reading without noise; what acts after the noise acts on it as it is."""
        reading = self._plant.reading_N(record.drive, effects, record.seed)
        if on := effects.get("quantisation"):
            reading = quantised(reading, on.parameters["step_N"])
        if on := effects.get("sensor_dropout"):
            reading = frozen(reading, record.drive.time_s, frozen_places(on))
        return reading

    def _effect(
        self, name: str, wanted: float, context: Context, visible: Visible
    ) -> tuple[Effect, dict[str, object]] | None:
        """An effect of the strength wanted, or of another that is plausible, and what the truth says of it."""
        scope = SINCE
        if name in ENTRIES:
            entry = ENTRIES[name]
            scope = entry.scopes[int(self._rng.integers(len(entry.scopes)))]
        others = [s for s in STRENGTHS if s != wanted]
        self._rng.shuffle(others)
        for strength in (wanted,) if self._strict else (wanted, *others):
            found = self._scaled(name, scope, strength, context, visible)
            if found is not None:
                return found
        return None

    def _scaled(
        self, name: str, scope: str, strength: float, context: Context, visible: Visible
    ) -> tuple[Effect, dict[str, object]] | None:
        if name in FOREIGN:
            foreign = FOREIGN[name]
            low, high = foreign.least, foreign.most
            drawn: tuple[dict[str, float], dict[str, object]] = {}, foreign.details(self._rng)
            entry = Entry("amount", lambda at: (low, high), lambda rng, at: drawn)  # noqa: ARG005
        else:
            entry = ENTRIES[name]
            low, high = entry.bounds(context)
            drawn = entry.draw(self._rng, context)
        measure = _measure(visible, name, scope)

        def shows_N(scale: float) -> float:
            return measure(self._reading(self._work, {name: entry.effect(name, scope, drawn, scale)}))

        scale = find_scale(shows_N, strength * self._noise.rms_N, low, high) if low < high else None
        if scale is None:
            return None
        effect = entry.effect(name, scope, drawn, scale)
        if not entry.plausible(effect):
            return None
        reading = self._reading(self._work, {name: effect})
        raw_N = visible.after_gain_and_offset_N(reading)
        if name in FOREIGN and visible.after_neighbours_N(reading) < FOREIGNNESS * raw_N:
            return None
        truth: dict[str, object] = {
            "name": name,
            "parameters": effect.parameters,
            "details": effect.details,
            "scope": scope,
            "strength": strength,
            "after_gain_and_offset_in_noise": raw_N / self._noise.rms_N,
            "after_refit_in_noise": visible.after_refit_N(reading) / self._noise.rms_N,
            "after_neighbours_in_noise": visible.after_neighbours_N(reading) / self._noise.rms_N,
            "where": [place | {"recording": self._work.name} for place in places(effect, context)],
        }
        return effect, truth

    def _all_show(self, effects: Mapping[str, Effect], truths: Sequence[dict[str, object]]) -> bool:
        """Whether each of several effects still shows beside the others; notes how much."""
        if len(effects) < 2:
            return True
        active = effects_in(effects, self._work.name)
        together = self._reading(self._work, active)
        for truth in truths:
            name, strength = str(truth["name"]), truth["strength"]
            assert isinstance(strength, float)
            rest = self._reading(self._work, {other: on for other, on in active.items() if other != name})
            visible = Visible(rest, self._work.drive.voltage_V, self._rate_Hz)
            shows_N = _measure(visible, name, str(truth["scope"]))(together)
            truth["beside_the_others_in_noise"] = shows_N / self._noise.rms_N
            if shows_N < SHOWN_TOGETHER * strength * self._noise.rms_N:
                return False
        return True


def _measure(visible: Visible, name: str, scope: str) -> Callable[[Array], float]:
    """What an effect's strength is measured by: the part of it that nothing else can take away."""
    if name in FOREIGN:
        return visible.after_neighbours_N
    return visible.after_gain_and_offset_N if scope == SINCE else visible.after_refit_N
