"""Every constant that decides what a search accepts, with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """Constants of acceptance; losses and gains are mean squares per sample [noise variance].

    Parameters
    ----------
    worth, steadily
        An effect must gain worth exp(-steadiness / steadily) of the loss that it leaves. Chosen by 921 decisions in 422
        replay files of four families, the same with each family left out (`python -m tests.studies rules`).
    steady
        Least steadiness of a flexible effect. On these files it loses no hidden effect, and keeps out five of 25 false
        ones in foreign cases.
    better
        Factor on a loss below which a hypothesis is preferred to another one: beyond the scatter of repeated fits.
    far_behind
        Factor on the loss of the best hypothesis from which another one is not refined: its choices, holds or starts
        lower a loss by less.
    isolated
        A block that no hypothesis predicts counts with its loss in the fit. It is one whose leave-one-block-out loss is
        this many times the loss in the fit; 99.9 % of all blocks stay below.
    largest_share
        Largest gain of one block in the steadiness, in median gains; a larger one would hide all others.
    parameter_price, most_priced
        Relative price of a parameter in the loss, up to so many parameters: of equal fits the plainer one is taken.
    general_price, most_general
        A general effect must beat a specific rival by this share of its gain, at most by this share of its loss.
    most_effects
        Largest number of new effects.
    at_noise
        Loss at which the search ends; 5 % is the scatter of a noise estimate from a few hundred samples.
    stack_alone
        Share of the loss that a change of the stack may leave to be taken before any effect: a new effect may do the
        same.
    known_first
        Share of the loss after a change of what is known, below which a new effect is taken in its place: the prior
        odds. A thermal drift that bent the creep of a concealed bench left 0.08 of it; true changes leave noise.
    beside_known
        Least gain of a new effect or of a change, where a given model with effects predicts the recordings within
        `findings.ABOVE_NOISE` [noise variance]. Unchanged models leave up to 0.66 more than the noise in new recordings
        of concealed lives. Five false names gained 0.25 to 0.52. Errors of changed models were 5 and more.
    dominant_tone
        Share of its recordings' loss that a tone may leave to be removed before other effects are tried.
    edge
        Share of a recording from its begin within which a step is what an unknown start leaves.
    """

    worth: float = 0.22
    steadily: float = 5.0
    steady: float = 3.0
    better: float = 0.98
    far_behind: float = 4.0
    isolated: float = 10.0
    largest_share: float = 3.0
    parameter_price: float = 0.01
    most_priced: int = 8
    general_price: float = 0.1
    most_general: float = 0.5
    most_effects: int = 5
    at_noise: float = 1.05
    stack_alone: float = 0.05
    known_first: float = 0.5
    beside_known: float = 0.6
    dominant_tone: float = 0.3
    edge: float = 0.02


RULES = Rules()
