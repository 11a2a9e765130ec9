"""A made-up diagnosis: a delay, a load step and a frozen reading, in one or several recordings."""

from pathlib import Path

import numpy as np

from piezod.diagnose.findings import Finding, Findings, Place, Rival, Value
from piezod.diagnose.judgement import Diagnosis
from piezod.estimation.recordings.series import Series
from piezod.model import load_model

MODEL = load_model(Path(__file__).parents[3] / "config" / "model.yaml")
DT_S = 0.002

DELAY = Finding(
    name="transport_delay",
    title="transport delay",
    confidence=0.97,
    scope="already",
    where=(),
    parameters={"delay_s": Value(0.0098831, "s", 0.009802, 0.009964)},
    before=1.976,
    after=0.48,
    rivals=(Rival("sensor_filter", 0.12, "the phase of a chirp"), Rival("resonance", 3.0, "the phase of a chirp")),
    handling="compensated",
)
STEP = Finding(
    name="load_step",
    title="step of the load",
    confidence=0.75,
    scope="once",
    where=(Place("time_s", 4.0, 6.0),),
    parameters={"step_N": Value(3.0, "N", 2.9, 3.1)},
    before=0.9,
    after=0.48,
    handling="refused",
    why="nobody knows when it comes",
)
FROZEN = Finding(
    name="sensor_dropout",
    title="frozen reading",
    confidence=0.97,
    scope="once",
    where=(Place("time_s", 2.0, 2.1),),
    parameters={"from_s": Value(2.0, "s", 2.0, 2.0), "to_s": Value(2.1, "s", 2.1, 2.1)},
    before=2.82,
    after=2.82,
    handling="corrected in the reading",
    why="nothing was read there",
)
REFITTED = 1.9  # N
WHERE = (
    Place("rate_V_per_s", 100.0, 200.0, 0.75, 0.01),
    Place("time_s", 4.0, 6.0, 0.3, 0.01),
    Place("frequency_Hz", 50.0, 50.0, 0.2, 0.02),
    Place("direction", -1.0, 1.0, 0.1, 0.02),
)


def series(name, role="recording", seconds=12.0, temperature=None, start_s=0.0, seed=1):
    time_s = np.arange(round(seconds / DT_S)) * DT_S
    u = 60.0 + 60.0 * np.sin(2 * np.pi * 0.5 * time_s)
    noise = np.random.default_rng(seed).normal(0.0, 0.1, u.size)
    counts = np.ones(u.size, bool)
    counts[1000:1050] = False
    kelvin = None if temperature is None else temperature + 0.1 * time_s
    return Series(name, role, time_s, u, 2.0 * u + noise, counts, 0.1, temperature_C=kelvin, start_s=start_s)


def diagnosis(effects=(DELAY, STEP, FROZEN), verdict="explained", recordings=None, notes=(), where=WHERE):
    made = [series("identification.csv", "identification"), *(recordings or [series("work.csv")])]
    findings = Findings(
        verdict=verdict,
        words="",
        unit="N",
        floor=0.447,
        floor_from="quiet",
        where=where,
        effects=effects,
        before=2.82,
        after=0.48 if effects or verdict == "matches" else 2.82,
        nrmse_before=97.0,
        nrmse_after=99.5,
        explainable=0.6 if "un" in verdict or "partly" in verdict else 0.001,
        notes=notes,
        refitted=None if effects else 0.48 if verdict == "matches" else REFITTED,
        recordings=tuple({"path": one.name, "sha256": "ab" * 32, "samples": one.time_s.size} for one in made),
    )
    base = [one.reading_N + np.roll(one.command_V, 5) - one.command_V for one in made]
    extended = [2.0 * one.command_V for one in made]
    return Diagnosis(findings, MODEL, made, base, extended)
