"""Draws a case: bench, plant, noise, and effects of given strengths.

A strength is relative to the noise of the readings. A voltmeter's noise reaches the expected force, and adds to it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.force_law import ForceLaw
from firmware_sim.concealed.plant.hysteresis import Hysteresis, Kind, draw_hysteresis, draw_noncongruent
from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.plant.sampling import quantised
from firmware_sim.concealed.plant.second_input import OUTSIDE_CATALOGUE, SECOND_INPUTS
from firmware_sim.concealed.study.bench import draw_bench, draw_varied_bench
from firmware_sim.concealed.study.case import Case, Noise, Record, dropped_out, effects_in
from firmware_sim.concealed.study.catalogue import ENTRIES, frozen_spans, places
from firmware_sim.concealed.study.entry import COME_SINCE, EITHER, RAMP_SAMPLES, Context, Entry
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.strength import VisibleDifference, find_scale

STRENGTHS = (0.8, 4.0, 20.0)  # [noise rms]
NOISE_SHARES = {"white": 0.45, "coloured": 0.3, "quantised": 0.25}
LEAST_NOISE, MOST_NOISE = 0.0002, 0.003  # [range]
FINE_STEP = (0.05, 0.35)  # step of an ordinary converter [noise rms]
MISFIT = 0.12  # largest residual of superposed plays on the hysteresis [noise rms]
SHOWN_TOGETHER = 0.5  # smallest share of its strength that an effect shows beside the others
FOREIGNNESS = 0.25  # smallest share of a foreign effect that catalogue effects cannot reproduce
ATTEMPTS = 72  # one of a hundred cases has no plausible draw in 18
STRICT_ATTEMPTS = 8  # attempts before another strength is allowed


@dataclass(frozen=True)
class CaseSpec:
    """Specification of a case.

    Parameters
    ----------
    kind
        One of `plan.KINDS`.
    names
        Names of its effects; an effect outside the catalogue stands first.
    strengths
        Strength of each effect [noise rms]; replaced by another one where it is not plausible.
    noise
        `white`, `coloured` or `quantised`.
    family
        One of `FAMILIES`; empty: laws drawn for each case.
    varied
        Whether the bench is varied (`bench.draw_varied_bench`).
    """

    kind: str
    names: tuple[str, ...]
    strengths: tuple[float, ...]
    noise: str
    family: str = ""
    varied: bool = False


def draw_case(spec: CaseSpec, seed: np.random.SeedSequence) -> Case:
    """Draw a case; an implausible draw is discarded and repeated.

    Parameters
    ----------
    spec
        Kind of the case and names of its effects.

    Raises
    ------
    StudyError
        No attempt gave a plausible case.
    """
    for attempt, child in enumerate(seed.spawn(ATTEMPTS)):
        case = _Attempt(spec, np.random.Generator(np.random.PCG64(child)), strict=attempt < STRICT_ATTEMPTS).case()
        if case is not None:
            return case
    names = "+".join(spec.names)
    raise StudyError(f"{spec.kind} {names}: no plausible case in {ATTEMPTS} attempts; take another --seed")


class _Attempt:
    """One attempt to draw a case."""

    def __init__(self, spec: CaseSpec, rng: np.random.Generator, *, strict: bool) -> None:
        self._spec, self._rng, self._strict = spec, rng, strict
        self._family = FAMILIES.get(spec.family)
        straight = any(ENTRIES[name].straight for name in spec.names if name in ENTRIES)
        bench = self._bench = (draw_varied_bench if spec.varied else draw_bench)(rng, straight=straight)
        self._rate_Hz, self._reach_V, self._full_N = bench.rate_Hz, bench.reach_V, bench.full_N
        self._work = next(record for record in bench.records if record.name.startswith("recording"))
        self._plant = self._draw_plant()
        self._noise = self._draw_noise()
        self._input_noise_N = self._full_N * bench.voltmeter.noise_V / self._reach_V
        self._floor_N = math.hypot(self._noise.rms_N, self._input_noise_N)

    def case(self) -> Case | None:
        """Draw the effects and return the case; None: it is not plausible."""
        if self._misfit_N() > MISFIT * self._noise.rms_N * 1.01:
            return None
        drive = self._work.drive
        u = drive.voltage_V
        fastest, lasting = (float(np.abs(u[n:] - u[:-n]).max()) / n * self._rate_Hz for n in (1, RAMP_SAMPLES))
        context = Context(
            self._reach_V, self._full_N, self._rate_Hz, self._floor_N, float(drive.time_s[-1]), fastest, lasting
        )
        plain = self._reading(self._work, {})
        visible = VisibleDifference(plain, drive.voltage_V, self._rate_Hz)
        effects: dict[str, Effect] = {}
        truths: list[dict[str, object]] = []
        for name, strength in zip(self._spec.names, self._spec.strengths, strict=True):
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
            "kind": self._spec.kind,
            "family": self._spec.family,
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
            "held": self._bench.held,
            "read_late_samples": self._bench.late,
        }
        if self._spec.varied:
            truth["bench"] = self._bench.truth
            truth["floor_N"], truth["input_noise_N"] = self._floor_N, self._input_noise_N
        bench = self._bench
        return Case(self._spec.kind, self._plant, self._noise, bench.records, effects, shows, truth, bench.voltmeter)

    def _draw_plant(self) -> Plant:
        rng = self._rng
        kinds: tuple[Kind, ...] = ("preisach", "plays", "bouc_wen")
        shares = (0.45, 0.35, 0.2)
        if "rate_dependent_hysteresis" in self._spec.names:
            kinds, shares = ("plays", "plays", "bouc_wen"), (0.4, 0.3, 0.3)
        kind = kinds[int(rng.choice(3, p=shares))]
        if self._family:
            by_rate = "rate_dependent_hysteresis" in self._spec.names
            kind = self._family.with_rate if by_rate else self._family.hysteresis
        core = draw_hysteresis(rng, kind, self._reach_V)
        law = ForceLaw(self._full_N, rng.uniform(-0.2, 0.25), rng.uniform(-0.06, 0.12))
        return Plant(core, draw_noncongruent(rng, self._reach_V), law)

    def _draw_noise(self) -> Noise:
        rng, kind = self._rng, self._spec.noise
        least = min(max(LEAST_NOISE, self._misfit_N() / self._full_N / MISFIT), MOST_NOISE)
        rms_N = self._full_N * float(np.exp(rng.uniform(np.log(least), np.log(MOST_NOISE))))
        step_N = rms_N * rng.uniform(*FINE_STEP) if kind == "quantised" else 0.0
        return Noise(kind, rms_N, float(np.exp(rng.uniform(np.log(0.5), np.log(20.0)))), step_N)

    def _misfit_N(self) -> float:
        """Residual of superposed plays on the hysteresis of the first recording, without effects [N]."""
        drive = self._work.drive
        return self._full_N * superposition_misfit(self._plant.hysteresis, drive.voltage_V, drive.rate_Hz)

    def _reading(self, record: Record, effects: Mapping[str, Effect]) -> Array:
        """Reading without noise, with quantisation and frozen spans, shape (n,) [N]."""
        reading = self._plant.reading_N(record.drive, effects, record.seed)
        if on := effects.get("quantisation"):
            reading = quantised(reading, on.parameters["step_N"])
        if on := effects.get("sensor_dropout"):
            reading = dropped_out(reading, record.drive.time_s, on, self._full_N)
        return reading

    def _effect(
        self, name: str, target: float, context: Context, visible: VisibleDifference
    ) -> tuple[Effect, dict[str, object]] | None:
        """Draw an effect of the target strength, or of another plausible one; return it and its truth."""
        scope = COME_SINCE
        if name in ENTRIES:
            entry = ENTRIES[name]
            scope = entry.scopes[int(self._rng.integers(len(entry.scopes)))]
        elif name in SECOND_INPUTS:
            scope = EITHER[int(self._rng.integers(len(EITHER)))]
        others = [s for s in STRENGTHS if s != target]
        self._rng.shuffle(others)
        for strength in (target,) if self._strict else (target, *others):
            found = self._at_strength(name, scope, strength, context, visible)
            if found is not None:
                return found
        return None

    def _at_strength(
        self, name: str, scope: str, strength: float, context: Context, visible: VisibleDifference
    ) -> tuple[Effect, dict[str, object]] | None:
        """Draw an effect and scale it to a strength; return it and its truth, or None where it is not plausible."""
        if name in OUTSIDE_CATALOGUE:
            foreign = OUTSIDE_CATALOGUE[name]
            low, high = foreign.least, foreign.most
            drawn: tuple[dict[str, float], dict[str, object]] = {}, foreign.details(self._rng)
            entry = Entry("amount", lambda bench: (low, high), lambda rng, bench: drawn)  # noqa: ARG005
        else:
            entry = ENTRIES[name]
            low, high = entry.bounds(context)
            drawn = entry.draw(self._rng, context)
            if self._family:
                drawn = drawn[0], drawn[1] | self._family.details(name, self._rng, context)
        measure = _measure(visible, name, scope)

        def shows_N(scale: float) -> float:
            return measure(self._reading(self._work, {name: entry.effect(name, scope, drawn, scale)}))

        scale = find_scale(shows_N, strength * self._floor_N, low, high) if low < high else None
        if scale is None:
            return None
        effect = entry.effect(name, scope, drawn, scale)
        if not entry.plausible(effect) or self._before_the_file(effect):
            return None
        reading = self._reading(self._work, {name: effect})
        raw_N = visible.after_gain_and_offset_N(reading)
        if name in OUTSIDE_CATALOGUE and visible.after_neighbours_N(reading) < FOREIGNNESS * raw_N:
            return None
        not_compared = self._family.not_compared.get(name, ()) if self._family else ()
        parameters = {key: value for key, value in effect.parameters.items() if key not in not_compared}
        if name == "friction" and effect.details.get("in_front"):
            parameters["force_N"] *= -1.0  # the cell in front of the guide reads it with the other sign
        truth: dict[str, object] = {
            "name": name,
            "parameters": parameters,
            "details": effect.details,
            "scope": scope,
            "strength": strength,
            "after_gain_and_offset_in_noise": raw_N / self._floor_N,
            "after_refit_in_noise": visible.after_refit_N(reading) / self._floor_N,
            "after_neighbours_in_noise": visible.after_neighbours_N(reading) / self._floor_N,
            "where": [place | {"recording": self._work.name} for place in places(effect, context)],
        }
        return effect, truth

    def _before_the_file(self, effect: Effect) -> bool:
        """Whether an event begins before the first sample that is written."""
        begin_s = effect.parameters.get("on_s", math.inf)
        if effect.name == "sensor_dropout":
            begin_s = min(low for low, _ in frozen_spans(effect))
        return begin_s < self._work.begin_s

    def _all_show(self, effects: Mapping[str, Effect], truths: Sequence[dict[str, object]]) -> bool:
        """Whether each effect still shows beside the others; adds the figure to its truth."""
        if len(effects) < 2:
            return True
        active = effects_in(effects, self._work.name)
        together = self._reading(self._work, active)
        for truth in truths:
            name, strength = str(truth["name"]), truth["strength"]
            assert isinstance(strength, float)
            rest = self._reading(self._work, {other: on for other, on in active.items() if other != name})
            visible = VisibleDifference(rest, self._work.drive.voltage_V, self._rate_Hz)
            shows_N = _measure(visible, name, str(truth["scope"]))(together)
            truth["beside_the_others_in_noise"] = shows_N / self._floor_N
            if shows_N < SHOWN_TOGETHER * strength * self._floor_N:
                return False
        return True


def superposition_misfit(hysteresis: Hysteresis, voltage_V: Array, rate_Hz: float) -> float:
    """Residual of superposed plays on a hysteresis over voltages from rest [range].

    Parameters
    ----------
    voltage_V
        Voltages, shape (n,) [V].
    rate_Hz
        Their rate [1/s].
    """
    visible = VisibleDifference(voltage_V, voltage_V, rate_Hz)
    return visible.after_refit_N(hysteresis.run(voltage_V)) / hysteresis.reach_V


def _measure(visible: VisibleDifference, name: str, scope: str) -> Callable[[Array], float]:
    """Measure of the strength of an effect: the part that a refitted model cannot absorb."""
    if name in OUTSIDE_CATALOGUE:
        return visible.after_neighbours_N
    return visible.after_gain_and_offset_N if scope == COME_SINCE else visible.after_refit_N
