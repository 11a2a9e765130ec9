"""Extended model: the given model with the refitted base and the effects of the diagnosis."""

from collections.abc import Mapping

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.findings import Value
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.stack_change import StackFactors, factors
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.selection.known_values import JointEstimate
from piezod.effects import EFFECTS
from piezod.errors import ModelError
from piezod.estimation.fit.columns import zone_weights_of
from piezod.estimation.recordings.start import starts_at_rest
from piezod.model import Model
from piezod.model.parameters import EffectValues, FitFigures, Hysteresis, Start, Superposition
from piezod.operators import EPS

PIECES = 30  # linear pieces of the force law in the model file
KINK_CLEARANCE = 1e-2  # share of the stroke range; a regular knot nearer than this to a kink is omitted


def extended_model(
    model: Model,
    chain: Chain,
    fitted: Fitted,
    hysteresis: Hysteresis,
    hashes: list[str],
    intervals: Mapping[str, Mapping[str, Value]],
) -> Model:
    """Given model with another hysteresis, and with the effects of a hypothesis.

    Unchanged effects and effects of other recordings stay as in the given model.

    Parameters
    ----------
    hysteresis
        Result of `hysteresis_of` or `scaled_hysteresis`.
    hashes
        SHA-256 of every recording; an effect of a single recording refers to it by its hash.

    Raises
    ------
    ModelError
        The operators have no inverse.
    """
    diagnosed = [series for series in chain.series if series.role == "recording"] or list(chain.series)
    first = hashes[next((k for k, series in enumerate(chain.series) if series.role == "recording"), 0)]
    held = {term.effect.name for term in fitted.terms if term.held}
    tones = {term.effect.name for term in fitted.terms if term.scope == "once"}
    effects = tuple(
        effect
        for effect in model.effects
        if effect.name in held or (effect.recording not in (None, *hashes) and effect.name not in tones)
    )
    effects += tuple(
        EffectValues(
            name=term.effect.name,
            parameters=stored_parameters(term, values),
            intervals=_intervals(term, intervals.get(term.effect.name, {})),
            recording=hashes[term.series] if term.scope == "once" else None,
            since={"already": "identification", "since": first}.get(term.scope),
        )
        for term, values in zip(fitted.terms, fitted.point.values, strict=True)
        if not term.held and term.effect.name in EFFECTS
    )
    changed = {
        "hysteresis": hysteresis,
        "effects": effects,
        "sampling": diagnosed[0].hold.sampling,
        "read_after": diagnosed[0].hold.read_after,
        "seen_s": chain.seen_s or max(series.duration_s for series in diagnosed),
        "sample_s": diagnosed[0].dt_s,
        "start": _start(model, chain),
    }
    extended = model.model_copy(update=changed)
    extended.operator()
    return extended


def with_joint_estimates(model: Model, refined: Mapping[str, JointEstimate]) -> Model:
    """Given model with the joint estimates of effects that have not changed."""
    effects = tuple(
        effect.model_copy(
            update={
                "parameters": {**effect.parameters, **_shortened(refined[effect.name].values)},
                "intervals": _joint_intervals(effect, refined[effect.name]),
            }
        )
        if effect.name in refined and effect.recording is None
        else effect
        for effect in model.effects
    )
    return model.model_copy(update={"effects": effects})


def _joint_intervals(effect: EffectValues, joint: JointEstimate) -> dict[str, tuple[float, float]] | None:
    """Intervals of the parameters that the file states; a part that the joint estimate does not know stays."""
    known = {
        name: (_short(joint.intervals[name][0]), _short(joint.intervals[name][1])) if name in joint.intervals else ends
        for name, ends in (effect.intervals or {}).items()
    }
    return known or None


def with_error(model: Model, rms: float) -> Model:
    """Model with the rms error of its own simulation [output unit] in its provenance."""
    provenance = model.provenance.model_copy(update={"fit": FitFigures(rms_held_out=rms)})
    return model.model_copy(update={"provenance": provenance})


def _intervals(term: Term, parameters: Mapping[str, Value]) -> dict[str, tuple[float, float]] | None:
    """Intervals of all parameters except instants; None if there are none."""
    known = {name: value for name, value in parameters.items() if not term.effect.parameter(name).instant}
    return {name: (_short(value.low), _short(value.high)) for name, value in known.items()} or None


def _short(value: float) -> float:
    return float(f"{value:.8g}")


def stored_parameters(term: Term, values: Mapping[str, float]) -> dict[str, float]:
    """Parameters and choices of a fitted effect with 8 digits, for a model file."""
    return _shortened({**values, **dict(term.choices)})


def _shortened(values: Mapping[str, float]) -> dict[str, float]:
    return {key: _short(value) for key, value in values.items()}


def _start(model: Model, chain: Chain) -> Start:
    """Start of the diagnosed recordings if it is at rest and common to all; else the start of the model."""
    diagnosed = (series for series in chain.series if series.role == "recording")
    paths = {series.path_V for series in diagnosed if starts_at_rest(series.command_V)}
    if len(paths) != 1 or any(len(path) not in (0, 2) for path in paths):
        return model.start
    path = paths.pop()
    return Start(kind="reset", peak=path[0]) if path else Start(kind="virgin")


def scaled_hysteresis(given: Hysteresis, now: StackFactors) -> Hysteresis:
    """Hysteresis of the given model with the factors of a changed stack."""
    first, *others = given.plays.weights
    weights = (first + (1.0 - now.loops) * sum(others), *(now.loops * weight for weight in others))
    zones = given.dead_zones
    return given.model_copy(
        update={
            "plays": given.plays.model_copy(update={"weights": weights}),
            "dead_zones": Superposition(
                thresholds=tuple(threshold / now.stroke for threshold in zones.thresholds),
                weights=tuple(now.stroke * now.force * weight for weight in zones.weights),
            ),
            "offset": now.force * given.offset,
        }
    )


def hysteresis_of(chain: Chain, fitted: Fitted) -> Hysteresis:
    """Fitted density and force law as play operators and one-sided dead-zone operators.

    Raises
    ------
    ModelError
        The operators have no inverse.
    """
    now = factors(fitted.terms, fitted.point)
    weights = chain.density.weights(now.loops * fitted.point.density)
    thresholds = np.concatenate(([0.0], chain.density.thresholds_V))
    low_V, high_V = (end * max(1.0, 1.0 / now.stroke) for end in _stroke_range(chain, fitted))
    zones, slopes, offset = _pieces(chain, fitted, low_V, high_V)
    slopes = np.maximum(slopes, 2.0 * EPS * slopes.max())
    if np.cumsum(weights).min() < EPS:
        raise ModelError(
            f"the refitted plays fold: their smallest slope is {np.cumsum(weights).min():.3g}, must be at least {EPS}; "
            "record triangles over the whole range besides"
        )
    return Hysteresis(
        plays=Superposition(thresholds=tuple(thresholds.tolist()), weights=tuple(weights.tolist())),
        dead_zones=Superposition(
            thresholds=tuple(zones.tolist()), weights=tuple(zone_weights_of(zones, slopes).tolist())
        ),
        offset=offset,
    )


def _stroke_range(chain: Chain, fitted: Fitted) -> tuple[float, float]:
    strokes = [chain.run(k, fitted.terms, fitted.point).stroke_V for k in range(len(chain.series))]
    return min(float(stroke.min()) for stroke in strokes), max(float(stroke.max()) for stroke in strokes)


def _pieces(chain: Chain, fitted: Fitted, low_V: float, high_V: float) -> tuple[Array, Array, float]:
    """Thresholds (0 among them), the slope outwards of each, and the output at 0.

    The piece around 0 has one slope; if all strokes lie above 0, the first piece is continued down to 0.
    """
    now = factors(fitted.terms, fitted.point)
    knots, kinks = np.linspace(low_V, high_V, PIECES + 1), np.sort(chain.law.kinks_V / now.stroke)
    kinks = kinks[(kinks > low_V) & (kinks < high_V)]
    if kinks.size:
        clear = np.min(np.abs(knots[:, None] - kinks), axis=1) > KINK_CLEARANCE * (high_V - low_V)
        clear[[0, -1]] = True
        knots = np.sort(np.concatenate((knots[clear], kinks)))
    values = now.force * chain.law.value(now.stroke * knots, fitted.point.law)
    rises = np.diff(values) / np.diff(knots)
    centre = int(np.clip(np.searchsorted(knots, 0.0, side="right") - 1, 0, knots.size - 2))
    below, above = np.arange(1, centre + 1), np.arange(centre + 1, knots.size - 1)
    below = below[knots[below] < 0.0]
    zones = np.concatenate((knots[below], [0.0], knots[above]))
    slopes = np.concatenate((rises[below - 1], [rises[centre]], rises[above]))
    return zones, slopes, float(values[centre] - rises[centre] * knots[centre])
