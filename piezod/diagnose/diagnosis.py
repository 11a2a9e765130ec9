"""From recordings and a model to findings: prepare, search, judge, and say how sure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.chain import Chain, Term
from piezod.diagnose.direct import lattice_step_N
from piezod.diagnose.extended import extended_model
from piezod.diagnose.findings import Finding, Findings, Place, Rival, Value, Verdict
from piezod.diagnose.fit import Fitted, Normal, fit
from piezod.diagnose.guard import Guard, explainable
from piezod.diagnose.ideas import DIRECT
from piezod.diagnose.locate import locate
from piezod.diagnose.motion import Motion, motion
from piezod.diagnose.parallel import each
from piezod.diagnose.places import place_of
from piezod.diagnose.prepare import Source, chain_of, even, stand_in, started, without_frozen
from piezod.diagnose.search import Search, search, without
from piezod.diagnose.series import Series
from piezod.diagnose.testable import untestable
from piezod.diagnose.tones import Tone, with_tones
from piezod.effects import EFFECTS
from piezod.errors import ModelError
from piezod.identify.scores import nrmse_percent
from piezod.model import Model

Array = NDArray[np.float64]
OnProgress = Callable[[str], None]

STILL_EXPLAINABLE = 0.1  # share of what is left, from which a verdict says that something is missing
MUCH_EXPLAINABLE = 0.75  # the same, from which it is said whatever was explained: twice the noise is left
BY_LEVEL = 0.25  # share of what is left that must lie above that at the lowest force
SURE = 0.01  # p below which that share is believed
CLOSED = 0.9  # part of what could be explained, from which it counts as explained
PARTLY = 0.9  # most that a name is believed whose effect leaves much to explain
MOSTLY = 0.8  # of the catalogue: recordings that could not have shown so much of it tell nothing
FOLDED = 0.6  # of its confidence that an effect keeps when the plays fold that were refitted with it
LEAST_CONFIDENCE, LEAST_ALONE = 0.3, 0.08  # below which an effect is not named, beside others or at all
RIVAL = 0.8  # part of the winner's gain, from which another effect is a rival
NORMAL_95 = 1.96
MOST_SPREAD = 20.0  # of an interval on its scale: beyond it a parameter is not determined
COARSE = 0.5  # of the other noise: a converter's step / sqrt(12) beyond it is a finding


@dataclass(frozen=True)
class Diagnosis:
    """Findings and what they rest on.

    Parameters
    ----------
    findings
        The verdict.
    model
        The given model with what was found; the given one where nothing was.
    series
        All recordings, made ready.
    base, extended
        Simulated readings of every recording, the given model's and the extended one's.
    """

    findings: Findings
    model: Model
    series: list[Series]
    base: list[Array]
    extended: list[Array]


def diagnose(
    model: Model, asked: Sequence[Source], past: Sequence[Source], notes: Sequence[str], progress: OnProgress
) -> Diagnosis:
    """Find what the model leaves out of the recordings.

    Parameters
    ----------
    model
        As it was identified.
    asked
        Recordings to explain.
    past
        Recordings that the model was identified on; none: its statistics stand for them.
    notes
        What was noticed so far.
    progress
        Told what is being done.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    progress("reading")
    said = list(notes)
    series: list[Series] = []
    frozen: dict[int, list[tuple[int, int]]] = {}
    for source in (*past, *asked):
        one, more = even(source, model)
        one, stretches = without_frozen(started(one, model), model)
        if stretches:
            frozen[len(series)] = stretches
        said += more
        series.append(one)
    if not past:
        series.insert(0, stand_in(model))
        frozen = {number + 1: stretches for number, stretches in frozen.items()}
    given = [_given(model, one) for one in series]
    chain, start = chain_of(series, model)
    result = search(chain, start, progress)
    progress("judging what is left")
    judged = partial(_judged, model, [*past, *asked], given=given, frozen=frozen, notes=said, stand_ins=not past)
    diagnosis = judged(result)
    while doubtful := _doubtful(result, diagnosis.findings):
        progress("leaving out what is doubtful")
        result = _without(result, doubtful)
        diagnosis = judged(result)
    return diagnosis


def _doubtful(result: Search, findings: Findings) -> list[str]:
    """Effects that explain little beside what remains unexplained: more likely the shape of something else."""
    fitted = [one for one in findings.effects if one.name in result.names]
    weak = [one for one in fitted if one.confidence < LEAST_CONFIDENCE]
    strongest = max(fitted, key=lambda one: one.confidence, default=None)
    return [one.name for one in weak if one is not strongest or one.confidence < LEAST_ALONE]


def _without(result: Search, names: Sequence[str]) -> Search:
    """The same search with some effects left out of what it found."""
    found = result.found
    for name in names:
        terms, values = without(found, name)
        found = replace(found, terms=tuple(terms), point=replace(found.point, values=tuple(values)))
    back = [tone for tone in result.tones if tone.name in names]
    chain = result.chain.like(with_tones(result.chain.series, back))
    kept = [tone for tone in result.tones if tone.name not in names]
    base = fit(chain, (), result.base.point) if back else result.base
    return replace(result, chain=chain, tones=kept, base=base, found=fit(chain, found.terms, found.point))


def _given(model: Model, series: Series) -> Array:
    """Readings that the given model expects, its offset adapted: a tare is no mismatch."""
    operator = model.hysteresis.operator()
    operator.run(np.array(series.path_V))
    expected = operator.run(series.command_V)
    return expected + float(np.mean((series.reading_N - expected)[series.counts]))


def _judged(
    model: Model,
    sources: Sequence[Source],
    result: Search,
    *,
    given: list[Array],
    frozen: dict[int, list[tuple[int, int]]],
    notes: list[str],
    stand_ins: int,
) -> Diagnosis:
    chain, found = result.chain, result.found
    normal = Normal.at(chain, found.terms, found.point)
    residuals = [one.reading_N - modelled for one, modelled in zip(chain.series, normal.readings, strict=True)]
    left = explainable(chain.series, residuals, normal.readings)
    series = with_tones(chain.series, result.tones)
    simulated = [one.reading_N - residual for one, residual in zip(series, residuals, strict=True)]
    before = _rms([one.reading_N - given[k] for k, one in enumerate(series)], series)
    after = _held_out_rms(chain, found)
    floor, floor_from = _floor(chain.series, residuals, left)
    floor = min(floor, after)
    effects = each(lambda name: _finding(result, name), found.effects)
    effects += [_tone_finding(result, name) for name in dict.fromkeys(tone.name for tone in result.tones)]
    effects += _read_off(chain.series, frozen, residuals, before)
    hashes = [""] * stand_ins + [source.sha256 for source in sources]
    moving = motion(chain.series, residuals, normal.readings)
    share, closed = _remaining(result, left, moving)
    verdict = _verdict(share, closed, effects)
    blind = untestable(chain, found.terms, found.point)
    if verdict == "matches" and len(blind) > MOSTLY * (len(EFFECTS) - len(DIRECT)):
        verdict = "not_testable"
    effects = [_less_sure(one, share, closed if verdict == "partly_explained" else 1.0) for one in effects]
    extended, said = model, list(notes)
    if result.names or verdict != "matches":
        try:
            extended = extended_model(model, chain, _with_tones(found, result.tones), hashes)
        except ModelError as error:
            said.append(f"no extended model: {error}")
            # Plays that fold are no stack's: whatever they needed to fit is not understood yet.
            verdict = "partly_explained" if effects else "unexplained"
            effects = [replace(one, confidence=FOLDED * one.confidence) for one in effects]
    asked = [k for k, one in enumerate(series) if one.role == "recording"]
    measured = np.concatenate([series[k].reading_N[series[k].counts] for k in asked])
    by_given = np.concatenate([given[k][series[k].counts] for k in asked])
    by_found = np.concatenate([simulated[k][series[k].counts] for k in asked])
    base_residuals = [one.reading_N - given[k] for k, one in enumerate(series)]
    findings = Findings(
        verdict=verdict,
        words="",
        unit=model.output.unit,
        floor=floor,
        floor_from=floor_from,
        where=tuple(
            Place(one.axis, one.low, one.high, one.share, one.p) for one in locate(series, base_residuals, given)
        ),
        effects=tuple(effects),
        before=before,
        after=after if result.names else min(after, before),
        nrmse_before=nrmse_percent(measured, by_given),
        nrmse_after=nrmse_percent(measured, by_found),
        explainable=share,
        not_testable=blind,
        notes=tuple(said),
        recordings=tuple(
            {"path": s.recording.source, "sha256": s.sha256, "samples": int(s.recording.time_s.size)} for s in sources
        ),
    )
    findings = replace(findings, words=words_of(findings))
    return Diagnosis(findings, extended, series, given, simulated)


def _rms(residuals: Sequence[Array], series: Sequence[Series]) -> float:
    """Over the recordings asked about."""
    squares = [np.square(r[s.counts]) for r, s in zip(residuals, series, strict=True) if s.role == "recording"]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _held_out_rms(chain: Chain, fitted: Fitted) -> float:
    """Of blocks left out, over the recordings asked about [output unit]."""
    powers, samples, first = 0.0, 0.0, 0
    for series in chain.series:
        part = slice(first, first + len(series.blocks))
        first += len(series.blocks)
        if series.role == "recording":
            powers += float(fitted.losses[part] @ fitted.samples[part]) * series.noise_N**2
            samples += float(fitted.samples[part].sum())
    return float(np.sqrt(powers / samples))


def _floor(series: Sequence[Series], residuals: Sequence[Array], left: Guard) -> tuple[float, str]:
    """What no model could explain: quiet holds where there are some, else the spectrum's high end or the absorber's."""
    quiet = [
        value for one, r in zip(series, residuals, strict=True) if one.role == "recording" for value in _holds(one, r)
    ]
    rms = _rms(residuals, series)
    if len(quiet) >= 3:
        return min(float(np.sqrt(np.mean(np.square(quiet)))), rms), "quiet"
    return rms * float(np.sqrt(max(1.0 - left.share, 0.0))), "spectrum"


def _holds(series: Series, residual: Array) -> list[float]:
    """Standard deviation of the residual in every stretch of half a second in which the command rests."""
    size = max(int(0.5 / series.dt_s), 20)
    found = []
    for first in range(0, series.command_V.size - size, size):
        part = slice(first, first + size)
        if np.ptp(series.command_V[part]) == 0.0 and series.counts[part].all():
            found.append(float(np.std(residual[part])))
    return found


def _finding(result: Search, name: str) -> Finding:
    chain, found = result.chain, result.found
    place = next(k for k, term in enumerate(found.terms) if term.effect.name == name)
    term, values = found.terms[place], found.point.values[place]
    terms, others = without(found, name)
    fewer = fit(chain, terms, replace(found.point, values=tuple(others))) if terms else result.base
    parameters = {}
    for one in term.effect.catalogued:
        value = {**values, **dict(term.choices)}[one.name]
        error = min(NORMAL_95 * found.spread[place].get(one.name, 0.0), MOST_SPREAD)
        low, high = (
            (value * np.exp(-error), value * np.exp(error)) if one.logarithmic else (value - error, value + error)
        )
        parameters[one.name] = Value(value, one.unit, float(max(low, one.low)), float(min(high, one.high)))
    if term.effect.name == "noncongruent_minor_loops":
        parameters["share"] = _share(result, place)
    rivals = _rivals(result, term)
    gain = float(np.log(fewer.loss / found.loss))
    return Finding(
        term.effect.name,
        term.effect.title,
        _confidence(gain, rivals),
        term.scope,
        place_of(term, values, chain),
        parameters,
        _held_out_rms(chain, fewer),
        _held_out_rms(chain, found),
        rivals,
        term.effect.handling,
        term.effect.why,
    )


def _with_tones(found: Fitted, tones: Sequence[Tone]) -> Fitted:
    """The hypothesis with the tones as effects that happened once."""
    terms = tuple(Term(EFFECTS[tone.name], "once", tone.number) for tone in tones)
    values = (*found.point.values, *(tone.values for tone in tones))
    return replace(found, terms=(*found.terms, *terms), point=replace(found.point, values=values))


def _tone_finding(result: Search, name: str) -> Finding:
    """A tone as a finding."""
    effect, after = EFFECTS[name], _held_out_rms(result.chain, result.found)
    mine = [tone for tone in result.tones if tone.name == name]
    parameters = {}
    for one in effect.catalogued:
        values = np.array([tone.values[one.name] for tone in mine])
        error = _tone_error(one.name, float(values.mean()), mine, result.chain)
        parameters[one.name] = Value(
            float(values.mean()), one.unit, float(values.min()) - error, float(values.max()) + error
        )
    before = float(np.sqrt(after**2 + _power(result.chain, mine)))
    return Finding(
        effect.name,
        effect.title,
        _confidence(2.0 * float(np.log(before / after)), ()),
        "once",
        place_of(Term(effect, "once", mine[0].number), mine[0].values, result.chain),
        parameters,
        before,
        after,
        (),
        effect.handling,
        effect.why,
    )


def _tone_error(name: str, value: float, mine: Sequence[Tone], chain: Chain) -> float:
    """Half of the 95 % interval of a tone's amplitude [N] or frequency [Hz] in white noise (Cramer and Rao)."""
    tone = mine[0]
    series = chain.series[tone.number]
    count, duration_s = series.time_s.size, max(series.duration_s, 1e-9)
    relative = series.noise_N / max(tone.values["amplitude_N"], 1e-300) * float(np.sqrt(2.0 / count))
    if name == "amplitude_N":
        return NORMAL_95 * relative * value
    return NORMAL_95 * relative * float(np.sqrt(12.0)) / (2.0 * np.pi * duration_s)


def _share(result: Search, place: int) -> Value:
    """Part of what the plays lag behind that depends on the bias, by rms over the recordings asked about.

    From what no plays and no curve follow up to all of it: how much of another hysteresis is congruent, nothing tells.
    """
    chain, found = result.chain, result.found
    bends = {name: x for name, x in found.point.values[place].items() if name.startswith(("degree_1", "curve"))}
    others = tuple(bends if number == place else values for number, values in enumerate(found.point.values))
    congruent = replace(found.point, values=others)
    shares = []
    for k, series in enumerate(chain.series):
        if series.role == "recording":
            rows = chain.rows[k]
            with_it, without_it = (chain.run(k, found.terms, point) for point in (found.point, congruent))
            added_V, columns = (with_it.stroke_V - without_it.stroke_V)[rows], with_it.columns[rows]
            curve = np.polynomial.chebyshev.chebvander(2.0 * series.command_V[rows] / chain.voltage_span_V - 1.0, 4)
            followed = np.hstack((columns, curve))
            left_V = added_V - followed @ np.linalg.lstsq(followed, added_V, rcond=None)[0]
            lags_V = max(float(np.std(columns @ found.point.density)), 1e-12)
            shares.append((float(np.std(left_V)) / lags_V, float(np.std(added_V)) / lags_V))
    low, value = np.clip(np.mean(shares, axis=0), 0.0, 1.0).tolist()
    return Value(value, "1", low, 1.0)


def _rivals(result: Search, term: Term) -> tuple[Rival, ...]:
    """Other effects that came near when this one was accepted, by how far they stay behind in noises."""
    rivals: list[Rival] = []
    for round_ in result.rounds:
        if round_.accepted.terms[-1].effect is not term.effect:
            continue
        reached = round_.before.loss - round_.accepted.loss
        for other in round_.others:
            effect = other.terms[-1].effect
            if round_.before.loss - other.loss > RIVAL * reached and effect.name not in {r.name for r in rivals}:
                behind = max(other.loss - round_.accepted.loss, 0.0)
                rivals.append(Rival(effect.name, float(np.sqrt(behind)), term.effect.separate_by))
    return tuple(sorted(rivals, key=lambda rival: rival.separation)[:3])


def _confidence(gain: float, rivals: Sequence[Rival]) -> float:
    """From how much the loss falls and how near the closest rival comes."""
    nearest = min((rival.separation for rival in rivals), default=3.0)
    return float(np.clip(0.99 - 0.35 * np.exp(-gain / 0.1) - 0.4 * np.exp(-nearest / 0.15), 0.05, 0.99))


def _read_off(
    series: Sequence[Series], frozen: dict[int, list[tuple[int, int]]], residuals: Sequence[Array], before: float
) -> list[Finding]:
    """What the readings show without a fit: frozen stretches, a coarse lattice."""
    found = []
    places = tuple(
        Place("time_s", series[k].start_s + a * series[k].dt_s, series[k].start_s + b * series[k].dt_s)
        for k, stretches in frozen.items()
        for a, b in stretches
        if series[k].role == "recording"
    )
    if places:
        effect = EFFECTS["sensor_dropout"]
        parameters = {"from_s": places[0].low, "to_s": places[0].high}
        values = {name: Value(value, "s", value, value) for name, value in parameters.items()}
        found.append(
            Finding(
                effect.name, effect.title, 0.97, "once", places, values, before, before, (), effect.handling, effect.why
            )
        )
    step, rest = _coarsest(series, residuals)
    if step > 0.0 and step / np.sqrt(12.0) > COARSE * rest:
        effect = EFFECTS["quantisation"]
        values = {"step_N": Value(step, "N", 0.99 * step, 1.01 * step)}
        found.append(
            Finding(
                effect.name, effect.title, 0.95, "since", (), values, before, before, (), effect.handling, effect.why
            )
        )
    return found


def _coarsest(series: Sequence[Series], residuals: Sequence[Array]) -> tuple[float, float]:
    """The coarsest lattice among the recordings asked about, and the noise besides it."""
    steps = [(lattice_step_N(one), k) for k, one in enumerate(series) if one.role == "recording"]
    step, k = max(steps)
    spread = float(np.std(residuals[k][series[k].counts]))
    return step, float(np.sqrt(max(spread**2 - step**2 / 12.0, 0.0)))


def _less_sure(one: Finding, share: float, closed: float) -> Finding:
    """The same, believed less where as much is left to explain as it explains."""
    own, left = max(one.before**2 - one.after**2, 0.0), share * one.after**2
    if one.before == one.after:  # read off the readings: no fit says anything
        return one
    alone = own / (own + left) if share > STILL_EXPLAINABLE else 1.0
    return replace(one, confidence=one.confidence * alone * (PARTLY * closed if closed < 1.0 else 1.0))


def _remaining(result: Search, left: Guard, moving: Motion) -> tuple[float, float]:
    """Share of what is left that something could still explain, and how much of all that could be explained was."""
    local = left.local_share if left.local_p < SURE else 0.0
    by_level = moving.level_share if moving.level_share > BY_LEVEL else 0.0
    share = max(left.share if left.p < SURE else 0.0, moving.share, by_level, local)
    before, after = (_held_out_rms(result.chain, one) ** 2 for one in (result.base, result.found))
    before += _power(result.chain, result.tones)
    explainable_N2 = before - (1.0 - share) * after
    return share, float(np.clip((before - after) / explainable_N2, 0.0, 1.0)) if explainable_N2 > 0.0 else 1.0


def _verdict(share: float, closed: float, effects: Sequence[Finding]) -> Verdict:
    missing = share > STILL_EXPLAINABLE
    if effects:
        return "partly_explained" if share > MUCH_EXPLAINABLE or (missing and closed < CLOSED) else "explained"
    return "unexplained" if missing else "matches"


def _power(chain: Chain, tones: Sequence[Tone]) -> float:
    """Of tones, over the recordings asked about."""
    samples = sum(one.time_s.size for one in chain.series if one.role == "recording")
    return sum(float(tone.heard_N @ tone.heard_N) for tone in tones) / samples


def _said(one: Finding) -> str:
    """An effect with its first parameter and where it is seen, as a person would say it."""
    said = one.title
    for name, value in list(one.parameters.items())[:1]:
        scale, unit = (100.0, "%") if value.unit == "1" else (1.0, value.unit)
        what = (
            ""
            if name == "per_decade"
            else f" {name.removesuffix('_' + value.unit.replace('/', '_per_')).replace('_', ' ')}"
        )
        numbers = f"{scale * value.value:.3g} {unit}{' per decade' if name == 'per_decade' else ''}"
        said += f",{what} {numbers} ({scale * value.low:.3g} to {scale * value.high:.3g})"
    if one.where:
        place = one.where[0]
        axis, _, unit = place.axis.partition("_")
        span = f"{place.low:.3g}" if place.low == place.high else f"{place.low:.3g} to {place.high:.3g}"
        said += f", seen at {axis} {span} {unit.replace('_per_', '/')}".rstrip()
    return said


def words_of(findings: Findings) -> str:
    """The verdict in a few sentences."""
    unit = findings.unit
    parts = [_said(one) for one in findings.effects]
    fell = f"held-out error {findings.before:.3g} -> {findings.after:.3g} {unit}, noise {findings.floor:.3g} {unit}"
    opening = {
        "matches": "The model matches the recordings; nothing is missing",
        "explained": "; ".join(parts),
        "partly_explained": "; ".join(parts),
        "unexplained": "Something is missing that no effect of the catalogue explains",
        "not_testable": "The recordings do not excite the bench enough to tell",
    }[findings.verdict]
    more = f"{100 * findings.explainable:.0f} % of what is left is no noise"
    rest = {
        "explained": "nothing else is left" if findings.explainable <= STILL_EXPLAINABLE else more,
        "partly_explained": more,
        "unexplained": more,
    }.get(findings.verdict)
    return "; ".join(one for one in (opening, fell, rest) if one)
