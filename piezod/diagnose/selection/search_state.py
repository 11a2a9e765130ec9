"""The state of a search, which never changes: a move makes a new one."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.findings import ABOVE_NOISE
from piezod.diagnose.hypothesis import stack_change
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.hypothesis.systematic import systematic_errors
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.given_effects import Status
from piezod.diagnose.selection.known_values import JointEstimate
from piezod.diagnose.selection.replay import Attempt
from piezod.model.information import Information


@dataclass(frozen=True)
class Round:
    """An accepted effect.

    Parameters
    ----------
    before, accepted
        Hypothesis without and with the effect.
    others
        Hypotheses with another effect that was plausible too.
    """

    before: Fitted
    accepted: Fitted
    others: tuple[Fitted, ...]


@dataclass(frozen=True)
class Rivalry:
    """Losses of the final hypothesis without an effect, with it, and with each rival in its place.

    Losses with an effect are those of `acceptance.comparison_loss`.
    """

    without: float
    with_effect: float
    rivals: Mapping[str, float]


@dataclass(frozen=True)
class Search:
    """State of a search.

    Parameters
    ----------
    chain
        Recordings with the hold of the command that fits best; the readings are without the removed tones.
    base
        Base with the effects of the given model at their values: the hypothesis that nothing has changed.
    hypothesis
        Hypothesis so far.
    past
        Base as the recordings of the identification alone show it.
    rounds
        Accepted effects, in the order of the search.
    tones
        Tones that were removed from the readings.
    rivalries
        Comparison with the rivals at the end, by effect.
    attempts
        Comparisons for the replay file.
    statuses
        Status of each effect of the given model, by name.
    refined
        Joint estimates of kept effects, from the given model and these recordings, by name.
    stack
        Recordings and hypothesis by which a change of the stack was estimated; None: as in the state.
    known
        Information of the given model on its parameters; None: it states none.
    known_tones_Hz
        Frequencies of the tones of the given model.
    predicted
        Error of the given model's own simulation over the noise of the recordings [1].
    ended_early
        Whether the time of the search was over before it ended by itself.
    """

    chain: Chain
    base: Fitted
    hypothesis: Fitted
    past: Point
    rounds: tuple[Round, ...] = ()
    tones: tuple[Tone, ...] = ()
    rivalries: Mapping[str, Rivalry] = field(default_factory=dict)
    attempts: tuple[Attempt, ...] = ()
    statuses: Mapping[str, Status] = field(default_factory=dict)
    refined: Mapping[str, JointEstimate] = field(default_factory=dict)
    stack: tuple[Chain, Fitted] | None = None
    known: Information | None = None
    known_tones_Hz: tuple[float, ...] = ()
    predicted: float = np.inf
    ended_early: bool = False

    @property
    def given(self) -> tuple[str, ...]:
        """Effects of the given model."""
        return self.base.effects

    @functools.cached_property
    def systematic(self) -> tuple[dict[str, float], ...]:
        """Result of `systematic_errors` for the hypothesis."""
        return systematic_errors(self.chain, self.hypothesis)

    @property
    def has_known(self) -> bool:
        """Whether the given model has effects or tones."""
        return bool(self.given or self.known_tones_Hz)

    @property
    def least_gain(self) -> float:
        """Least gain of a difference from the given model, in addition to `acceptance.worth` [noise variance]."""
        return RULES.beside_known if self.has_known and self.predicted <= ABOVE_NOISE else 0.0

    @property
    def new(self) -> tuple[str, ...]:
        """Effects of the hypothesis that the given model lacks, tones last."""
        names = dict.fromkeys((*self.hypothesis.effects, *(tone.name for tone in self.diagnosed_tones)))
        return tuple(name for name in names if name not in (*self.given, *stack_change.NAMES))

    @property
    def stack_changed(self) -> bool:
        """Whether the gain or the loops of the stack differ from the identification."""
        return any(name in self.hypothesis.effects for name in stack_change.NAMES)

    @property
    def differs(self) -> bool:
        """Whether anything is new, changed or gone."""
        return bool(self.new) or self.stack_changed or not {"changed", "gone"}.isdisjoint(self.statuses.values())

    @property
    def names(self) -> tuple[str, ...]:
        """All effects of the hypothesis, tones last."""
        return tuple(dict.fromkeys((*self.hypothesis.effects, *(tone.name for tone in self.tones))))

    @property
    def diagnosed_tones(self) -> tuple[Tone, ...]:
        """Tones in the recordings to explain."""
        return tuple(tone for tone in self.tones if self.chain.series[tone.number].role == "recording")

    def on_chain(self, chain: Chain, fitted: Fitted, **changes: object) -> "Search":
        """State with a hypothesis on another chain; the base is fitted to it too."""
        base = self.base if chain is self.chain else fit(chain, self.base.terms, self.base.point)
        return replace(self, chain=chain, hypothesis=fitted, base=base, **changes)  # type: ignore[arg-type]

    def with_corners(self, chain: Chain, fitted: Fitted) -> "Search":
        """State with corners in the base."""
        start = replace(fitted.point, values=self.base.point.values)
        base = fit(chain, self.base.terms, start, most_steps=MOST_STEPS)
        past = identified_base(chain, base.point, base.terms)
        return replace(self, chain=chain, hypothesis=fitted, base=base, past=past)


def identified_base(chain: Chain, start: Point, given: tuple[Term, ...]) -> Point:
    """Base fitted to the recordings of the identification alone; the offsets of the others start at 0.

    Parameters
    ----------
    start
        Point to begin from.
    given
        Effects of the given model, held.
    """
    identified = [k for k, series in enumerate(chain.series) if series.role == "identification"]
    point = fit(chain.like([chain.series[k] for k in identified]), given, start.of(identified)).point
    offsets_N, starts = np.zeros(len(chain.series)), list(start.starts)
    offsets_N[identified] = point.offsets_N
    for k, fitted_start in zip(identified, point.starts, strict=True):
        starts[k] = fitted_start
    return replace(point, offsets_N=offsets_N, starts=tuple(starts))
