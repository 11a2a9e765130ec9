"""Candidates for the next move of a search, computed once for a state and only when a move asks for them."""

import functools
from collections.abc import Sequence

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import with_best_hold, with_refitted_starts
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import accepted, degenerate, penalised_loss
from piezod.diagnose.selection.replay import Attempt
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.tone_search import RemovedTone, strongest_tone
from piezod.diagnose.selection.trials import with_each_effect, with_own_step

FINALISTS = 2  # accepted hypotheses that are tried with every hold of the command
BESIDE_A_STEP = 2  # effects that a step was preferred to are tried beside a step of their own
REFITTED = 3  # rejected hypotheses that fit better and are compared again with their own initial state

Trial = tuple[Chain, Fitted]


class Candidates:
    """Hypotheses with one more effect or tone than a state has.

    Attributes
    ----------
    attempts
        Comparisons so far, for the replay file.
    """

    def __init__(self, state: Search) -> None:
        self.state = state
        self.attempts: list[Attempt] = []

    @functools.cached_property
    def tone(self) -> RemovedTone | None:
        """Strongest tone that may be removed."""
        return strongest_tone(self.state)

    @functools.cached_property
    def tried(self) -> list[Trial]:
        """Fitted hypotheses with one more effect, each with its chain."""
        state = self.state
        return with_each_effect(state.chain, state.hypothesis, state.past) + self._beside_the_last_step()

    @functools.cached_property
    def best(self) -> Trial | None:
        """Best accepted hypothesis with one more effect, with its best hold and initial states."""
        return min(self._finalists(), key=lambda trial: penalised_loss(trial[1]), default=None)

    def _beside_the_last_step(self) -> list[Trial]:
        """After a step of the load: the effects that it was preferred to, each with a step of its own."""
        state = self.state
        if not state.rounds or not state.hypothesis.terms or not state.hypothesis.terms[-1].effect.is_step:
            return []
        if not state.rounds[-1].accepted.point.alike(state.hypothesis.point):
            return []  # fitted before the base had corners
        others = sorted(state.rounds[-1].others, key=lambda other: other.loss)
        return with_own_step(state.chain, state.hypothesis, others[:BESIDE_A_STEP])

    def _finalists(self) -> list[Trial]:
        """Best accepted hypotheses, each with the hold and the initial states that fit best.

        A rejected hypothesis that fits better is refitted with its own initial state and hold, and compared again.
        It is compared with the state on its own chain, because the other hold may explain most of its gain.
        """
        state = self.state
        before = {id(state.chain): state.hypothesis}
        for chain, _ in self.tried:
            if id(chain) not in before:
                before[id(chain)] = fit(chain, state.hypothesis.terms, state.hypothesis.point, most_steps=6)

        def is_accepted(trial: Trial) -> bool:
            chain, after = trial
            if after.loss >= RULES.better * state.hypothesis.loss:
                return False
            return accepted(chain, before.get(id(chain), state.hypothesis), after)

        ordered = sorted(self.tried, key=lambda trial: trial[1].loss)
        good = []
        for chain, after in ordered:
            is_good = is_accepted((chain, after))
            good += [(chain, after)] * is_good
            known, unlike = before[id(chain)], degenerate(chain, after)
            self.attempts.append(Attempt("one", len(state.names), known, after, degenerate=unlike, accepted=is_good))
        limit = good[0][1].loss if good else state.hypothesis.loss
        rejected = [trial for trial in ordered if trial[1].loss < limit and not degenerate(*trial)][:REFITTED]
        refitted = [trial for trial in each(with_refitted_starts, rejected) if trial is not None and is_accepted(trial)]
        best = sorted(good + refitted, key=lambda trial: trial[1].loss)[:FINALISTS]
        return each(with_best_hold, [trial for trial in best if trial[1].loss < RULES.far_behind * best[0][1].loss])


def first_of_each(tried: Sequence[Fitted]) -> list[Fitted]:
    """Best hypothesis with each last effect, the best one first."""
    best: dict[str, Fitted] = {}
    for fitted in sorted(tried, key=lambda hypothesis: hypothesis.loss):
        best.setdefault(fitted.effects[-1], fitted)
    return list(best.values())
