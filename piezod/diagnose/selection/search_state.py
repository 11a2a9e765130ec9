"""How far a search has come: what was found, on which way, and what was tried beside it."""

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
    """One effect that was accepted, and what else was tried that is what its name says."""

    before: Fitted
    accepted: Fitted
    others: tuple[Fitted, ...]


@dataclass(frozen=True)
class Beside:
    """Losses beside all else that was found: without an effect, with it, and with each rival in its place.

    Those with an effect as they are counted (`acceptance.counted`).
    """

    without: float
    with_it: float
    rivals: Mapping[str, float]


@dataclass
class Search:
    """What was found and on which way.

    Parameters
    ----------
    chain
        Recordings, with the course between samples that fits best.
    base
        The base beside the effects of the given model, each held at its values: nothing has changed.
    found
        The hypothesis at the end.
    past
        The base as the recordings show it that the model was identified on.
    rounds
        In the order of the search.
    tones
        What was taken off the readings of the chain's series.
    beside
        By effect, what was tried in its place at the end.
    attempts
        What was compared, for the replay file.
    statuses
        What has become of each effect of the given model, by name.
    """

    chain: Chain
    base: Fitted
    found: Fitted
    past: Point
    rounds: list[Round] = field(default_factory=list)
    tones: list[Tone] = field(default_factory=list)
    beside: dict[str, Beside] = field(default_factory=dict)
    attempts: list[Attempt] = field(default_factory=list)
    statuses: dict[str, Status] = field(default_factory=dict)

    @property
    def given(self) -> tuple[str, ...]:
        """Effects of the given model."""
        return self.base.effects

    @property
    def new(self) -> tuple[str, ...]:
        """Effects that were found and that the given model lacks, tones last."""
        found = dict.fromkeys((*self.found.effects, *(tone.name for tone in self.tones_asked_about)))
        return tuple(name for name in found if name not in (*self.given, *stack_change.NAMES))

    @property
    def stack_changed(self) -> bool:
        """Whether the stack itself has another gain or other loops than at the identification."""
        return any(name in self.found.effects for name in stack_change.NAMES)

    @property
    def differs(self) -> bool:
        """Whether anything is new, changed or gone."""
        return bool(self.new) or self.stack_changed or any(one in ("changed", "gone") for one in self.statuses.values())

    def fit_base(self, most_steps: int = MOST_STEPS) -> None:
        """Fit the base anew to the readings of the chain."""
        point = replace(self.found.point, values=self.base.point.values)
        self.base = fit(self.chain, self.base.terms, point, most_steps=most_steps)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that were found, tones last."""
        return tuple(dict.fromkeys((*self.found.effects, *(tone.name for tone in self.tones))))

    @property
    def tones_asked_about(self) -> list[Tone]:
        """Those in the recordings, without what was taken off the readings that the model was identified on."""
        return [tone for tone in self.tones if self.chain.series[tone.number].role == "recording"]
