"""The model with everything that was found, as a model file holds it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.findings import Value
from piezod.diagnose.hypothesis.chain import Chain, Term
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.stack_change import factors
from piezod.effects import EFFECTS
from piezod.errors import ModelError
from piezod.estimation.initial_state import starts_at_rest
from piezod.model import Model
from piezod.model.parameters import EffectValues, FitFigures, Hysteresis, Start, Superposition
from piezod.operators import EPS

Array = NDArray[np.float64]

PIECES = 30  # of the force law
BESIDE_A_KINK = 1e-2  # of the strokes' range: nearer than that to a kink no other piece begins


def extended_model(
    model: Model, chain: Chain, found: Fitted, hashes: list[str], intervals: Mapping[str, Mapping[str, Value]]
) -> Model:
    """The given model with refitted plays and force law, and the effects.

    Effects that have not changed, and those of recordings that are not among these, stay as the given model has them.

    Parameters
    ----------
    model
        As it was given.
    chain, found
        What the search found.
    hashes
        SHA-256 of every recording: effects that belong to one name it.
    intervals
        Parameters with their intervals, by effect.

    Raises
    ------
    ModelError
        The refitted operators have no inverse.
    """
    asked = [one for one in chain.series if one.role == "recording"] or list(chain.series)
    first = hashes[next((k for k, one in enumerate(chain.series) if one.role == "recording"), 0)]
    held = {term.effect.name for term in found.terms if term.held}
    tones = {term.effect.name for term in found.terms if term.scope == "once"}
    effects = tuple(
        one
        for one in model.effects
        if one.name in held or (one.recording not in (None, *hashes) and one.name not in tones)
    )
    effects += tuple(
        EffectValues(
            name=term.effect.name,
            parameters=stored_parameters(term, values),
            intervals=_intervals(term, intervals.get(term.effect.name, {})),
            recording=hashes[term.series] if term.scope == "once" else None,
            since={"already": "identification", "since": first}.get(term.scope),
        )
        for term, values in zip(found.terms, found.point.values, strict=True)
        if not term.held and term.effect.name in EFFECTS
    )
    changed = {
        "hysteresis": hysteresis_of(chain, found),
        "effects": effects,
        "sampling": asked[0].hold.sampling,
        "read_after": asked[0].hold.read_after,
        "seen_s": chain.seen_s or max(one.duration_s for one in asked),
        "sample_s": asked[0].dt_s,
        "start": _start(model, chain),
    }
    extended = model.model_copy(update=changed)
    extended.operator()
    return extended


def with_error(model: Model, rms: float) -> Model:
    """The model with the error that its own simulation leaves [unit of the output]."""
    provenance = model.provenance.model_copy(update={"fit": FitFigures(rms_held_out=rms)})
    return model.model_copy(update={"provenance": provenance})


def _intervals(term: Term, found: Mapping[str, Value]) -> dict[str, tuple[float, float]] | None:
    """Of the parameters that are no instants; None where none is known."""
    known = {name: one for name, one in found.items() if not term.effect.parameter(name).instant}
    return {name: (_short(one.low), _short(one.high)) for name, one in known.items()} or None


def _short(value: float) -> float:
    return float(f"{value:.8g}")


def stored_parameters(term: Term, values: Mapping[str, float]) -> dict[str, float]:
    """Of a fitted effect, for a model file."""
    return {key: _short(value) for key, value in {**values, **dict(term.choices)}.items()}


def _start(model: Model, chain: Chain) -> Start:
    """As the recordings asked about started, where they agree and started at rest."""
    paths = {one.path_V for one in chain.series if one.role == "recording" and starts_at_rest(one.command_V)}
    if len(paths) != 1 or any(len(path) not in (0, 2) for path in paths):
        return model.start
    path = paths.pop()
    return Start(kind="reset", peak=path[0]) if path else Start(kind="virgin")


def hysteresis_of(chain: Chain, found: Fitted) -> Hysteresis:
    """Density and splines as plays and dead zones."""
    gain, loops = factors(found)
    weights = chain.density.weights(loops * found.point.density)
    thresholds = np.concatenate(([0.0], chain.density.thresholds_V))
    low_V, high_V = (end * max(1.0, 1.0 / gain) for end in _stroke_range(chain, found))
    zones, slopes, offset = _pieces(chain, found, low_V, high_V)
    slopes = np.maximum(slopes, 2.0 * EPS * slopes.max())
    if np.cumsum(weights).min() < EPS:
        raise ModelError(
            f"the refitted plays fold: their smallest slope is {np.cumsum(weights).min():.3g}, must be at least {EPS}; "
            "record triangles over the whole range besides"
        )
    return Hysteresis(
        plays=Superposition(thresholds=tuple(thresholds.tolist()), weights=tuple(weights.tolist())),
        dead_zones=Superposition(thresholds=tuple(zones.tolist()), weights=_outwards(zones, slopes)),
        offset=offset,
    )


def _stroke_range(chain: Chain, found: Fitted) -> tuple[float, float]:
    strokes = [chain.run(k, found.terms, found.point).stroke_V for k in range(len(chain.series))]
    return min(float(one.min()) for one in strokes), max(float(one.max()) for one in strokes)


def _pieces(chain: Chain, found: Fitted, low_V: float, high_V: float) -> tuple[Array, Array, float]:
    """Thresholds with 0 among them, the slope outwards of each, and the output at 0.

    The piece around 0 has one slope; where the strokes begin above 0 the first piece is continued down to it.
    """
    gain, _ = factors(found)
    knots, kinks = np.linspace(low_V, high_V, PIECES + 1), np.sort(chain.law.kinks_V / gain)
    kinks = kinks[(kinks > low_V) & (kinks < high_V)]
    if kinks.size:
        beside = np.min(np.abs(knots[:, None] - kinks), axis=1) > BESIDE_A_KINK * (high_V - low_V)
        beside[[0, -1]] = True
        knots = np.sort(np.concatenate((knots[beside], kinks)))
    values = chain.law.value(gain * knots, found.point.law)
    rises = np.diff(values) / np.diff(knots)
    centre = int(np.clip(np.searchsorted(knots, 0.0, side="right") - 1, 0, knots.size - 2))
    below, above = np.arange(1, centre + 1), np.arange(centre + 1, knots.size - 1)
    below = below[knots[below] < 0.0]
    zones = np.concatenate((knots[below], [0.0], knots[above]))
    slopes = np.concatenate((rises[below - 1], [rises[centre]], rises[above]))
    return zones, slopes, float(values[centre] - rises[centre] * knots[centre])


def _outwards(zones: Array, slopes: Array) -> tuple[float, ...]:
    """Weights whose partial sums from the centre outwards are these slopes."""
    centre = int(np.flatnonzero(zones == 0.0)[0])
    lower = np.diff(slopes[centre::-1])[::-1]
    return tuple(np.concatenate((lower, [slopes[centre]], np.diff(slopes[centre:]))).tolist())
