"""What a diagnosis says, as the rest of the program and other programs read it (`findings.json`)."""

from dataclasses import dataclass, field
from typing import Any, Literal

Verdict = Literal["matches", "explained", "partly_explained", "unexplained", "not_testable"]
ABOVE_NOISE = 1.3  # times it: what is left then is more; coloured noise is seen up to 1.25 times weaker in holds
FINEST = 2e-4  # of the readings' range: nobody is asked to simulate better, whatever the noise
NO_GAP = 0.02  # of the noise's square: so little above it is nothing
UNKNOWN = "unknown"
"""Origin of a noise that shows nowhere in the recordings."""
SCHEMA = "piezod.findings/2"
Status = Literal["new", "changed", "gone"]


def gap_closed(before: float, after: float, floor: float) -> float:
    """(e0^2 - e1^2) / (e0^2 - floor^2) of errors [output unit] and noise: 1 down to it, 0 where there was no gap."""
    gap = before**2 - floor**2
    return (before**2 - after**2) / gap if gap > NO_GAP * floor**2 else 0.0


def above_noise(after: float, floor: float, span: float) -> bool:
    """Whether an error is more than noise, of whatever shape: both and the readings' range in the output's unit."""
    return after > ABOVE_NOISE * max(floor, FINEST * span)


@dataclass(frozen=True)
class Place:
    """Where something is.

    Parameters
    ----------
    axis
        time_s, frequency_Hz, voltage_V, rate_V_per_s, force_N, amplitude_V, history_s, temperature_C or direction.
    low, high
        On that axis; equal for a line.
    share
        Part of the unexplained energy.
    p
        Family-wise, 1 where it was not tested.
    """

    axis: str
    low: float
    high: float
    share: float = 0.0
    p: float = 1.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"axis": self.axis, "low": self.low, "high": self.high, "share": self.share, "p": self.p}


@dataclass(frozen=True)
class Value:
    """A parameter with its interval (95 %).

    Parameters
    ----------
    value, unit
        As it was fitted, and its unit.
    low, high
        Ends of the interval [unit].
    in_fit
        Ends of what the fit alone leaves open, without what the form of the model is off by; None: the same.
    """

    value: float
    unit: str
    low: float
    high: float
    in_fit: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"value": self.value, "unit": self.unit, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Rival:
    """An effect that would explain the same almost as well.

    Parameters
    ----------
    name
        Of the catalogue.
    separation
        Root mean square difference of what both say about these recordings, in units of the noise.
    separate_by
        The experiment that would tell them apart.
    """

    name: str
    separation: float
    separate_by: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"name": self.name, "separation": self.separation, "separate_by": self.separate_by}


@dataclass(frozen=True)
class Finding:
    """One effect that is new, or has changed since the given model.

    Parameters
    ----------
    name, title
        Of the catalogue.
    confidence
        Share of such findings that are right, from concealed cases.
    scope
        "already" there when the model was identified, "since", or "once" in one recording.
    where
        Its places.
    parameters
        By name.
    before, after
        Root mean square error on data left out, without it and with it [output unit].
    rivals
        Closest first.
    handling, why
        What the compensator does about it.
    p, q
        Probability that a useless effect predicts as well, and expected share of false names up to it; None for what is
        read off the readings without a fit.
    status
        "new": the given model lacks it. "changed": the given model has it with other values. "gone": the given model
        has it, and the recordings do not.
    was
        Parameters in the given model, by name; empty for a new effect.
    """

    name: str
    title: str
    confidence: float
    scope: str
    where: tuple[Place, ...]
    parameters: dict[str, Value]
    before: float
    after: float
    rivals: tuple[Rival, ...] = ()
    handling: str = ""
    why: str = ""
    p: float | None = None
    q: float | None = None
    status: Status = "new"
    was: dict[str, Value] = field(default_factory=dict)

    def as_dict(self, unit: str) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "status": self.status,
            "confidence": self.confidence,
            **({} if self.p is None or self.q is None else {"p_value": self.p, "q_value": self.q}),
            "scope": self.scope,
            "where": [place.as_dict() for place in self.where],
            "parameters": {
                name: value.as_dict() | ({"was": self.was[name].as_dict()} if name in self.was else {})
                for name, value in self.parameters.items()
            },
            "held_out": {"before": self.before, "after": self.after, "unit": unit},
            "rivals": [rival.as_dict() for rival in self.rivals],
            "handling": self.handling,
        }


@dataclass(frozen=True)
class Kept:
    """An effect of the given model that has not changed, as far as the recordings tell.

    Parameters
    ----------
    name
        Of the catalogue.
    parameters
        By name, as in the given model.
    seen
        Whether the recordings fit worse without it; else they could not tell.
    """

    name: str
    parameters: dict[str, Value]
    seen: bool

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        parameters = {name: value.as_dict() for name, value in self.parameters.items()}
        return {"name": self.name, "parameters": parameters, "seen": self.seen}


@dataclass(frozen=True)
class Base:
    """The stack itself, in parts of what it was when the model was identified.

    Parameters
    ----------
    changed
        Whether its gain or its loops differ.
    gain, loops
        Gain and width of the loops [1]; None: as they were.
    where
        Voltages of the recordings that show it.
    confidence
        Share of such findings that are right; 1 where nothing has changed.
    """

    changed: bool = False
    gain: Value | None = None
    loops: Value | None = None
    where: tuple[Place, ...] = ()
    confidence: float = 1.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "status": "changed" if self.changed else "kept",
            "gain": None if self.gain is None else self.gain.as_dict(),
            "loops": None if self.loops is None else self.loops.as_dict(),
            "where": [place.as_dict() for place in self.where],
            "confidence": self.confidence,
        }


@dataclass(frozen=True)
class HeldOut:
    """A recording that nothing was fitted to.

    Parameters
    ----------
    path, sha256
        Of the file.
    before, after
        Root mean square error of the given and of the extended model, each adapted to its tare [output unit].
    """

    path: str
    sha256: str
    before: float
    after: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"path": self.path, "sha256": self.sha256, "before": self.before, "after": self.after}


@dataclass(frozen=True)
class Unnamed:
    """An unnamed law: what it depends on, and what it is worth.

    Parameters
    ----------
    drivers
        One or two of `piezod.model.unnamed_law.DRIVERS`.
    memories_s
        Shortest and longest memory that matters [s]; empty: none does.
    already
        Whether it holds in the recordings of the identification too.
    before, after
        Root mean square error on data left out, without it and with it [output unit].
    p
        Probability that a useless law gains as much, over all candidates.
    gain
        Whether it multiplies the reading's stroke instead of adding to it.
    formula
        A short formula that predicts as well, with its units; empty: none is known.
    """

    drivers: tuple[str, ...]
    memories_s: tuple[float, ...]
    already: bool
    before: float
    after: float
    p: float
    gain: bool = False
    formula: str = ""

    def as_dict(self, unit: str) -> dict[str, Any]:
        """For JSON."""
        return {
            "drivers": list(self.drivers),
            "form": "gain" if self.gain else "added",
            "formula": self.formula or None,
            "memories_s": list(self.memories_s),
            "scope": "already" if self.already else "since",
            "held_out": {"before": self.before, "after": self.after, "unit": unit},
            "p_value": self.p,
        }


@dataclass(frozen=True)
class Unrecorded:
    """An input that is not recorded, as what is left shows it.

    Parameters
    ----------
    size
        Root mean square, as a gain [1], else added to the reading [output unit].
    gain
        Whether it multiplies.
    keeps_s
        How long it keeps its value [s].
    """

    size: float
    gain: bool
    keeps_s: float

    def as_dict(self, unit: str) -> dict[str, Any]:
        """For JSON."""
        size = {"value": self.size, "unit": "1" if self.gain else unit}
        return {"size": size, "form": "gain" if self.gain else "added", "keeps_s": self.keeps_s}


@dataclass(frozen=True)
class Findings:
    """The whole verdict.

    Parameters
    ----------
    verdict
        In one word.
    words
        In one or two sentences.
    unit
        Of the output.
    floor, floor_from
        Noise [output unit], and where it shows: quiet (rests) or repeats; `UNKNOWN`: `floor` is an upper bound.
    where
        Where the given model is wrong.
    effects
        What was found, the largest first.
    before, after
        Root mean square error that `piezod simulate` of the given and of the written model leaves on the recordings,
        about its mean [output unit]; equal where the given model stays.
    nrmse_before, nrmse_after
        Fit as MATLAB's `compare` defines it [%].
    explainable
        Share of what is left that is no noise: a flexible model explains it, or it follows movement or level.
    notes
        What was noticed on the way.
    not_testable
        Effects that these recordings would not have shown in their usual size.
    span
        Widest range of readings of a recording asked about [output unit].
    refitted
        Where nothing was found: the least error with a hysteresis that is refitted to the recordings. It is `after`
        where the written model has that hysteresis.
    kept
        Effects of the given model that have not changed.
    base
        The stack itself.
    law
        Law without a name that is in the extended model; None: there is none. `after` is then the error with it.
    held_out
        Recordings that nothing was fitted to.
    recordings
        Path, SHA-256 and samples of each.
    """

    verdict: Verdict
    words: str
    unit: str
    floor: float
    floor_from: str
    where: tuple[Place, ...]
    effects: tuple[Finding, ...]
    before: float
    after: float
    nrmse_before: float
    nrmse_after: float
    explainable: float
    notes: tuple[str, ...] = ()
    not_testable: tuple[str, ...] = ()
    span: float = 0.0
    refitted: float | None = None
    kept: tuple[Kept, ...] = ()
    base: Base = Base()
    law: Unnamed | None = None
    held_out: tuple[HeldOut, ...] = ()
    recordings: tuple[dict[str, Any], ...] = field(default_factory=tuple)
    unrecorded: Unrecorded | None = None

    @property
    def gap_closed(self) -> float | None:
        """Down to the noise; None where there was no gap."""
        no_gap = self.before**2 <= (1.0 + NO_GAP) * self.floor**2
        return None if no_gap else gap_closed(self.before, self.after, self.floor)

    @property
    def least(self) -> float:
        """The same, or that of a refitted hysteresis where nothing was found [output unit]."""
        return self.after if self.refitted is None else self.refitted

    @property
    def left(self) -> float:
        """Error of the written model [output unit]."""
        return self.after

    @property
    def above_noise(self) -> bool:
        """Whether more than noise is left, though it may be that nothing tells what it is."""
        return above_noise(self.left, self.floor, self.span)

    @property
    def noise_is_known(self) -> bool:
        """Whether the noise shows in the recordings; otherwise `floor` is an upper bound."""
        return self.floor_from != UNKNOWN

    @property
    def noise_text(self) -> str:
        """The noise with its unit, or what is known of it."""
        text = f"{self.floor:.3g} {self.unit}"
        return text if self.noise_is_known else f"unknown, at most {text}"

    def _noise_as_dict(self) -> dict[str, Any]:
        if self.noise_is_known:
            return {"value": self.floor, "unit": self.unit, "from": self.floor_from}
        return {"value": None, "unit": self.unit, "from": None, "at_most": self.floor}

    def as_dict(self) -> dict[str, Any]:
        """For `findings.json`, schema "piezod.findings/2"; what was in /1 has its place."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "words": self.words,
            "noise_floor": self._noise_as_dict(),
            "where": [place.as_dict() for place in self.where],
            "effects": [one.as_dict(self.unit) for one in self.effects],
            "kept": [one.as_dict() for one in self.kept],
            "base": self.base.as_dict(),
            "fit": {
                "unit": self.unit,
                "held_out": {
                    "before": self.before,
                    "after": self.after,
                    "floor": self.floor,
                    "gap_closed": self.gap_closed,
                },
                "held_out_recordings": [one.as_dict() for one in self.held_out],
                "nrmse_percent": {"before": self.nrmse_before, "after": self.nrmse_after},
            },
            "unexplained": {
                "explainable_share": self.explainable,
                "unrecorded_input": None if self.unrecorded is None else self.unrecorded.as_dict(self.unit),
            },
            "unnamed_law": None if self.law is None else self.law.as_dict(self.unit),
            "not_testable": list(self.not_testable),
            "notes": list(self.notes),
            "recordings": list(self.recordings),
        }
