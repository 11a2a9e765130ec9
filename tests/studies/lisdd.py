"""LISDD on the cases of a concealed study: localised, sparse discovery of a discrepancy, certified by an exact test.

python -m tests.studies lisdd STUDY VERDICTS, then piezod blind score STUDY VERDICTS

Written from the abstract of Y. Wang (2026), Where Is My Physics Wrong? Localized and Identifiable Discovery of Model
Discrepancy, arXiv:2606.23215, since the paper was not at hand. The known physics is the identified model with a gain
and an offset.

1. The operating space, command and its rate, is divided into cells. Gain and offset are fitted on the calm half.
2. Cells with more residual energy than the identification had are flagged, at 5 % over all cells.
3. In the flagged cells every candidate of the library is fitted to a third of the blocks, and compared on the second.
4. The best is tested on the last third by an F-test, and taken at a false-discovery rate of 5 %. This is repeated on
   the rest, at most three times, so that pairs and triples can be found.

The library has one candidate for each effect of the catalogue that has a term without hidden states, and first-order
memories for those that need one. Places are the flagged spans of command and rate.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.signal import lfilter

from piezod.blind.case import case_folders, read_description
from piezod.blind.diagnose_case import BASE, EXTENDED, identified
from piezod.blind.verdict import FINDINGS, Verdict, VerdictFolder, run_json
from piezod.identify.simulation import simulate_recording
from piezod.recording import Recording, read_recording, write_csv

CELLS = 6, 4  # quantiles of the command, and of its rate
ALPHA = 0.05
BLOCKS, TERMS = 30, 3
SAMPLES_PER_TRUTH = 20.0  # neighbouring residuals are no independent samples
MEMORIES_S = (0.01, 0.1, 1.0, 10.0)
HINGES = (0.1, 0.25, 0.5, 0.75, 0.9)  # of the range
SPREAD = 1e-9


def library(t, u, y, dt):
    """Candidates: (effect, columns)."""
    rate, velocity = np.gradient(u, dt), np.gradient(y, dt)
    span_u, span_y = np.ptp(u), np.ptp(y)
    lag = {tau: lfilter([dt / tau], [1.0, dt / tau - 1.0], y - y[0]) for tau in MEMORIES_S if tau > 2.0 * dt}
    scaled = (y - y.min()) / span_y
    out = [
        ("electrical_lag", [velocity]),
        ("resonance", [np.gradient(velocity, dt)]),
        ("feedthrough", [rate]),
        ("output_nonlinearity", [scaled**2, scaled**3]),
        ("gain_drift", [t * (y - y.mean())]),
        ("thermal_drift", [t]),
        ("clock_skew", [t * velocity]),
        ("friction", [np.sign(rate)]),
        ("rate_dependent_hysteresis", [np.sign(rate) * np.log1p(np.abs(rate) / (np.std(rate) + SPREAD))]),
        ("noncongruent_minor_loops", [np.sign(rate) * scaled]),
        ("charge_leakage", [np.cumsum(y - y[0]) * dt]),
        ("mains_hum", [f(2.0 * np.pi * 50.0 * t) for f in (np.sin, np.cos)]),
    ]
    out += [("creep", [one]) for one in lag.values()]
    out += [("voltage_clamp", [np.maximum(u - u.min() - h * span_u, 0.0)]) for h in HINGES]
    out += [("contact_gap", [np.maximum(h * span_y - (y - y.min()), 0.0)]) for h in HINGES]
    out += [("slew_limit", [rate * (np.abs(rate) > np.quantile(np.abs(rate), h))]) for h in HINGES]
    out += [("load_step", [(t > h * t[-1]).astype(float)]) for h in np.linspace(0.05, 0.95, 19)]
    return out


def tone(t, residual, dt):
    """The strongest line of the residual as a candidate."""
    power = np.abs(np.fft.rfft(residual - residual.mean()))
    frequency = float(np.fft.rfftfreq(residual.size, dt)[1 + int(np.argmax(power[1:]))])
    return ("vibration", [f(2.0 * np.pi * frequency * t) for f in (np.sin, np.cos)])


def cells_of(u, rate, edges):
    """Number of every sample's cell."""
    places = [
        np.clip(np.searchsorted(edge, one, side="right") - 1, 0, edge.size - 2)
        for one, edge in zip((u, rate), edges, strict=True)
    ]
    return places[0] * (edges[1].size - 1) + places[1]


def least_squares(columns, target):
    """Coefficients and squared error."""
    found, *_ = np.linalg.lstsq(columns, target, rcond=None)
    return found, float(np.sum((target - columns @ found) ** 2))


def discover(t, u, y, base, calm_variance):
    """Names, flagged spans, and p-values by name."""
    dt = float(t[1] - t[0])
    rate = np.gradient(u, dt)
    edges = [np.unique(np.quantile(one, np.linspace(0.0, 1.0, n + 1))) for one, n in zip((u, rate), CELLS, strict=True)]
    edges = [edge if edge.size > 1 else np.array([edge[0] - 1.0, edge[0] + 1.0]) for edge in edges]
    cell = cells_of(u, rate, edges)
    count = int(cell.max()) + 1
    size = np.bincount(cell, minlength=count)
    calm = np.ones(t.size, dtype=bool)
    physics = np.column_stack((base, np.ones(t.size)))
    for _ in range(5):
        found, _ = least_squares(physics[calm], y[calm])
        residual = y - physics @ found
        energy = np.bincount(cell, residual**2, minlength=count) / np.maximum(size, 1)
        calm = energy[cell] <= np.median(energy[size > 0])
    independent = np.maximum(size / SAMPLES_PER_TRUTH, 1.0)
    limit = calm_variance * stats.chi2.ppf(1.0 - ALPHA / count, independent) / independent
    flagged = (energy > limit) & (size > 0)
    inside = flagged[cell]
    if not flagged.any():
        return [], [], {}
    where = spans(edges, flagged.reshape(-1, edges[1].size - 1))
    third = (np.arange(t.size) * BLOCKS // t.size) % 3
    candidates, found, left = library(t, u, base, dt), {}, residual.copy()
    for _ in range(TERMS):
        best = None
        for name, columns in [*candidates, tone(t, left, dt)]:
            matrix = np.column_stack([*columns, np.ones(t.size)])
            fit, choose = inside & (third == 0), inside & (third == 1)
            if min(fit.sum(), choose.sum()) < 10 * matrix.shape[1]:
                continue
            coefficients, _ = least_squares(matrix[fit], left[fit])
            error = float(np.mean((left[choose] - matrix[choose] @ coefficients) ** 2))
            if best is None or error < best[0]:
                best = error, name, columns, matrix
        if best is None:
            break
        _, name, columns, matrix = best
        test = inside & (third == 2)
        _, with_it = least_squares(matrix[test], left[test])
        _, without = least_squares(np.ones((int(test.sum()), 1)), left[test])
        free = max(test.sum() / SAMPLES_PER_TRUTH - matrix.shape[1], 1.0)
        p = float(stats.f.sf(((without - with_it) / len(columns)) / (with_it / free), len(columns), free))
        if p > ALPHA / (len(candidates) + 1) * (len(found) + 1):
            break
        coefficients, _ = least_squares(matrix[inside], left[inside])
        left = left - matrix @ coefficients
        found.setdefault(name, p)
    return list(found), where, found


def spans(edges, flagged):
    """Flagged spans of command and rate."""
    out = []
    for axis, edge, hit in (
        ("voltage_V", edges[0], flagged.any(axis=1)),
        ("rate_V_per_s", edges[1], flagged.any(axis=0)),
    ):
        marked = np.flatnonzero(hit)
        if 0 < marked.size < hit.size:
            low, high = float(edge[marked[0]]), float(edge[marked[-1] + 1])
            out.append({"axis": axis, "low": low, "high": high, "share": 1.0, "p": ALPHA})
    return out


def diagnose(folder):
    """Findings of one case as files."""
    description = read_description(folder)
    model = identified(description, folder)

    def read(name):
        recording = read_recording(folder / name)
        base = simulate_recording(model, recording, 0.0).recording.channel(description.output)
        return (
            recording.time_s - recording.time_s[0],
            recording.channel(description.input),
            recording.channel(description.output),
            base,
        )

    _, _, y, base = read(description.identification)
    calm = np.var(y - base)
    names, where, p_values = [], [], {}
    for name in description.recordings:
        t, u, y, base = read(name)
        kept = np.isfinite(y) & np.isfinite(base)
        found, places, certain = discover(t[kept], u[kept], y[kept], base[kept], calm)
        names += [one for one in found if one not in names]
        where += places
        p_values |= certain
    verdict = "explained" if names else "unexplained" if where else "matches"
    effects = [
        {
            "name": one,
            "confidence": 1.0 - p_values[one],
            "scope": "since",
            "where": where,
            "parameters": {},
            "rivals": [],
        }
        for one in names
    ]
    findings = {"schema": "piezod.findings/1", "verdict": verdict, "words": "LISDD", "where": where, "effects": effects}
    return findings, model, description


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("study", type=Path)
    parser.add_argument("verdicts", type=Path)
    parser.add_argument("--like", type=Path, help="only the cases that have a verdict in this folder")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    """Write a verdict for every case."""
    saved = VerdictFolder(options.verdicts, options.study)
    for folder in case_folders(options.study, ()):
        if options.like is not None and not (options.like / folder.name).is_dir():
            continue
        begun_s = time.monotonic()
        findings, model, description = diagnose(folder)
        held_out = read_recording(folder / description.held_out)
        drive = Recording(held_out.time_s, {description.input: held_out.channel(description.input)}, {}, "held out")
        base = options.verdicts / "base.csv"
        write_csv(simulate_recording(model, drive, 0.0).recording, base)
        text = base.read_bytes()
        base.unlink()
        elapsed_s = time.monotonic() - begun_s
        content = (json.dumps(findings) + "\n").encode()
        files = {FINDINGS: content, "run.json": run_json(elapsed_s), EXTENDED: text, BASE: text}
        saved.save(Verdict(folder.name, files))
        print(folder.name, findings["verdict"], ", ".join(one["name"] for one in findings["effects"]), flush=True)
