"""State of a search: current hypothesis, rounds, rivals, and subtracted tones."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from piezod.diagnose.candidates.tones import Tone
from piezod.diagnose.hypothesis import stack_change
from piezod.diagnose.hypothesis.chain import Chain, Point
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.selection.given_effects import Status
from piezod.diagnose.selection.replay import Attempt


@dataclass(frozen=True)
class Round:
    """Accepted effect (`accepted`), hypothesis before it, and the other plausible hypotheses that were tried."""

    before: Fitted
    accepted: Fitted
    others: tuple[Fitted, ...]


@dataclass(frozen=True)
class Rivalry:
    """Losses of the final hypothesis without an effect, with it, and with each rival in its place.

    The losses with an effect are comparison losses (`acceptance.comparison_loss`).
    """

    without: float
    with_effect: float
    rivals: Mapping[str, float]


@dataclass
class Search:
    """State of a search.

    Parameters
    ----------
    chain
        Recordings with the best hold.
    base
        Base with the effects of the given model held at their values: the hypothesis that nothing has changed.
    hypothesis
        Current hypothesis.
    past
        Base fitted to the identification recordings.
    rounds
        Accepted effects in their order.
    tones
        Tones subtracted from the readings of the chain's series.
    rivalries
        Losses with each rival in place of an effect of the final hypothesis, by effect.
    attempts
        Compared hypotheses, for the replay file.
    statuses
        Status of each effect of the given model, by name.
    """

    chain: Chain
    base: Fitted
    hypothesis: Fitted
    past: Point
    rounds: list[Round] = field(default_factory=list)
    tones: list[Tone] = field(default_factory=list)
    rivalries: dict[str, Rivalry] = field(default_factory=dict)
    attempts: list[Attempt] = field(default_factory=list)
    statuses: dict[str, Status] = field(default_factory=dict)

    @property
    def given(self) -> tuple[str, ...]:
        """Effects of the given model."""
        return self.base.effects

    @property
    def new(self) -> tuple[str, ...]:
        """Effects that the given model lacks, tones last."""
        names = dict.fromkeys((*self.hypothesis.effects, *(tone.name for tone in self.diagnosed_tones)))
        return tuple(name for name in names if name not in (*self.given, *stack_change.NAMES))

    @property
    def stack_changed(self) -> bool:
        """Whether the gain or the loops of the stack differ from the identification."""
        return any(name in self.hypothesis.effects for name in stack_change.NAMES)

    @property
    def differs(self) -> bool:
        """Whether an effect or the stack is new, changed or gone."""
        return bool(self.new) or self.stack_changed or bool({"changed", "gone"} & set(self.statuses.values()))

    def fit_base(self, most_steps: int = MOST_STEPS) -> None:
        """Refit the base to the readings of the chain, from the current hypothesis."""
        point = replace(self.hypothesis.point, values=self.base.point.values)
        self.base = fit(self.chain, self.base.terms, point, most_steps=most_steps)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects of the current hypothesis, tones last."""
        return tuple(dict.fromkeys((*self.hypothesis.effects, *(tone.name for tone in self.tones))))

    @property
    def diagnosed_tones(self) -> list[Tone]:
        """Tones of the diagnosed recordings."""
        return [tone for tone in self.tones if self.chain.series[tone.number].role == "recording"]
