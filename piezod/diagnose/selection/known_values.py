"""Whether recordings agree with the values of an effect in the given model, by the information in its file.

Two estimates of the same values differ by their errors. With their covariances V0 and V1, the square of the difference
d^T (V0 + V1)^-1 d is then chi-square distributed (A. Wald (1943), Tests of Statistical Hypotheses Concerning Several
Parameters, Transactions of the American Mathematical Society 54(3)). Older recordings determine some directions badly:
V0 is large there, so no difference in them is a change. Estimates that agree are averaged with their information.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc  # type: ignore[import-untyped]

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal
from piezod.diagnose.hypothesis.layout import scaled, unscaled
from piezod.diagnose.hypothesis.left_out import covariance, form_error
from piezod.diagnose.hypothesis.systematic import systematic_errors
from piezod.effects.parameter import Parameter
from piezod.model.information import Information, marginal

DISCOVERIES = 0.05  # largest expected share of unchanged effects among those called changed
HALF_95 = 1.96  # half of a 95 % interval [standard errors]
LEAST = 1e-10  # least information in a direction, relative to that of a parameter whose companions are known
DETERMINED = 1e-12  # least information on a parameter, relative to that of a relative error of 1


@dataclass(frozen=True)
class JointEstimate:
    """Estimate of an effect from the given model and from new recordings.

    Parameters
    ----------
    p
        Probability that the two estimates differ as much if nothing has changed.
    values, intervals
        Values from both estimates, and their 95 % intervals, by parameter.
    """

    p: float
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]


def joint_estimate(
    chain: Chain, changed: Fitted, given: Mapping[str, float], name: str, known: Information
) -> JointEstimate | None:
    """Compare the fitted values of an effect with those of the given model; None without information on them.

    Parameters
    ----------
    chain, changed
        Recordings, and the hypothesis in which the effect is fitted.
    given
        Values of the effect in the given model.
    known
        Information of the recordings of the given model.
    """
    normal = Normal.at(chain, changed.terms, changed.point)
    searched = [
        (place, parameter)
        for place, (term, parameter) in enumerate(normal.layout.searched, start=normal.layout.effects)
        if changed.terms[term].effect.name == name and f"{name}.{parameter.name}" in known.names
    ]
    rows = np.array([known.names.index(f"{name}.{parameter.name}") for _, parameter in searched], dtype=np.int64)
    scales = np.array([_scale(parameter, given[parameter.name]) for _, parameter in searched])
    information = marginal(known.matrix, rows) * np.outer(scales, scales)
    seen = np.diag(information) > DETERMINED
    if not seen.any():
        return None
    searched = [pair for pair, is_seen in zip(searched, seen, strict=True) if is_seen]
    before = covariance_of(information[np.ix_(seen, seen)])
    moves = normal.left_out_moves()[:, [place for place, _ in searched]]
    since = covariance(moves, np.array([form_error(parameter, given[parameter.name]) for _, parameter in searched]))
    place = next(k for k, term in enumerate(changed.terms) if term.effect.name == name)
    values = changed.point.values[place]
    old = np.array([scaled(parameter, given[parameter.name]) for _, parameter in searched])
    new = np.array([scaled(parameter, values[parameter.name]) for _, parameter in searched])
    p, joint, both = averaged(old, new, before, since)
    parameters = [parameter for _, parameter in searched]
    alike = systematic_errors(chain, changed)[place]  # it is in both estimates, so an average does not lower it
    half = np.hypot(HALF_95 * np.sqrt(np.maximum(np.diag(both), 0.0)), [alike[one.name] for one in parameters])
    return JointEstimate(
        p,
        {**values, **_by_name(parameters, joint)},
        {
            parameter.name: (unscaled(parameter, centre - width), unscaled(parameter, centre + width))
            for parameter, centre, width in zip(parameters, joint, half, strict=True)
        },
    )


def averaged(old: Array, new: Array, before: Array, since: Array) -> tuple[float, Array, Array]:
    """Probability of such a difference by chance, average of two estimates, and its covariance.

    Parameters
    ----------
    old, new
        Estimates, shape (P,).
    before, since
        Their covariances, shape (P, P).
    """
    weighted = np.linalg.solve(before + since, np.column_stack((new - old, before)))
    p = float(chdtrc(old.size, float((new - old) @ weighted[:, 0])))
    return p, old + before @ weighted[:, 0], before - before @ weighted[:, 1:]


def covariance_of(information: Array) -> Array:
    """Inverse of an information matrix, shape (P, P); a direction without information gets a large variance."""
    scale = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse: Array = (vectors / np.maximum(values, LEAST)) @ vectors.T / np.outer(scale, scale)
    return inverse


def agreeing(estimates: Mapping[str, JointEstimate], count: int) -> dict[str, JointEstimate]:
    """Estimates of effects that have not changed, at a false-discovery rate of `DISCOVERIES` (Benjamini and Hochberg).

    `count`: number of things that may have changed; those without an estimate count as unchanged.
    """
    ordered = sorted(estimates, key=lambda name: estimates[name].p)
    limits = DISCOVERIES * np.arange(1, len(ordered) + 1) / max(count, 1)
    below = [k for k, name in enumerate(ordered) if estimates[name].p <= limits[k]]
    changed = ordered[: below[-1] + 1] if below else []
    return {name: estimate for name, estimate in estimates.items() if name not in changed}


def _scale(parameter: Parameter, value: float) -> float:
    """Change of a value with its place on the scale that is fitted."""
    return value if parameter.search.logarithmic else 1.0


def _by_name(parameters: Sequence[Parameter], vector: Array) -> dict[str, float]:
    return {
        parameter.name: unscaled(parameter, float(value)) for parameter, value in zip(parameters, vector, strict=True)
    }
