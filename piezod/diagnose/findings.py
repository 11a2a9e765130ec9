"""Findings of a diagnosis, and their form in `findings.json`."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

Verdict = Literal["matches", "explained", "partly_explained", "unexplained", "not_testable"]
ABOVE_NOISE = 1.3  # error over noise above which the error counts; holds show coloured noise up to 1.25 times too weak
FINEST = 2e-4  # share of the range of the readings: a smaller error never counts
NO_GAP = 0.02  # relative excess of the squared error over the squared noise below which there is no gap
UNKNOWN = "unknown"  # source of a noise that the recordings do not show
SCHEMA = "piezod.findings/2"
Status = Literal["new", "changed", "gone"]


def gap_closed(before: float, after: float, floor: float) -> float:
    """(e0^2 - e1^2) / (e0^2 - floor^2) of errors [output unit] and noise: 1 down to it, 0 where there was no gap."""
    gap = before**2 - floor**2
    return (before**2 - after**2) / gap if gap > NO_GAP * floor**2 else 0.0


def above_noise(after: float, floor: float, span: float) -> bool:
    """Whether an error exceeds the noise floor, for readings of range `span`; all in [output unit]."""
    return after > ABOVE_NOISE * max(floor, FINEST * span)


@dataclass(frozen=True)
class Place:
    """Range on an axis in which an effect or an error shows.

    Parameters
    ----------
    axis
        time_s, frequency_Hz, voltage_V, rate_V_per_s, force_N, amplitude_V, history_s, temperature_C or direction.
    low, high
        Ends of the range; equal for a line.
    share
        Share of the unexplained energy [1].
    p
        Family-wise p-value, 1 if not tested.
    """

    axis: str
    low: float
    high: float
    share: float = 0.0
    p: float = 1.0


@dataclass(frozen=True)
class Value:
    """Value of a parameter with its 95 % interval.

    Parameters
    ----------
    low, high
        Ends of the interval [unit].
    in_fit
        Ends of the interval from the fit alone, without the error of the effect's form; None: low and high.
    """

    value: float
    unit: str
    low: float
    high: float
    in_fit: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Entry in `findings.json`."""
        return {"value": self.value, "unit": self.unit, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Rival:
    """Other effect that explains the recordings almost as well."""

    name: str  # name in the catalogue
    separation: float  # rms difference of the readings that both effects predict [noise rms]
    separate_by: str  # experiment


@dataclass(frozen=True)
class Finding:
    """Effect that is new, changed or gone since the given model.

    Parameters
    ----------
    confidence
        Share of such findings that are right in concealed cases [1].
    scope
        "already" present at the identification, "since", or "once" in one recording.
    before, after
        Rms error on left-out blocks without and with the effect [output unit]. A changed effect has its old values in
        the first. A gone effect is in the hypothesis of the first. Equal for a finding without a fit.
    rivals
        Rivals, the closest first.
    handling, why
        Handling by the compensator and its reason.
    p, q
        Probability that a useless effect predicts as well, and false-discovery rate; None without a test.
    status
        Change relative to the given model.
    was
        Parameters in the given model by name; empty for a new effect.
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
        """Entry in `findings.json`."""
        return {
            "name": self.name,
            "status": self.status,
            "confidence": self.confidence,
            **({} if self.p is None or self.q is None else {"p_value": self.p, "q_value": self.q}),
            "scope": self.scope,
            "where": [asdict(place) for place in self.where],
            "parameters": {
                name: value.as_dict() | ({"was": self.was[name].as_dict()} if name in self.was else {})
                for name, value in self.parameters.items()
            },
            "held_out": {"before": self.before, "after": self.after, "unit": unit},
            "rivals": [asdict(rival) for rival in self.rivals],
            "handling": self.handling,
        }


@dataclass(frozen=True)
class UnchangedEffect:
    """Effect of the given model that has not changed."""

    name: str  # name in the catalogue
    parameters: dict[str, Value]  # of the given model
    seen: bool  # whether the recordings fit worse without it; otherwise they do not determine it
    measured: dict[str, Value] = field(default_factory=dict)  # its size by these recordings alone

    def as_dict(self) -> dict[str, Any]:
        """Entry in `findings.json`."""
        return {
            "name": self.name,
            "parameters": {name: value.as_dict() for name, value in self.parameters.items()},
            "seen": self.seen,
            "measured": {name: value.as_dict() for name, value in self.measured.items()},
        }

    def with_measured(self, size: Value | None, name: str) -> "UnchangedEffect":
        """The effect with its measured size, a parameter of this name; None: not measured."""
        return self if size is None else replace(self, measured={name: size})


@dataclass(frozen=True)
class Base:
    """Change of the stack itself since the identification.

    Parameters
    ----------
    changed
        Whether the gain or the loops differ.
    gain, loops
        Gain and width of the loops relative to the identification [1]; None: unchanged.
    confidence
        Share of such findings that are right [1]; 1 without a change.
    measured
        Gain [output unit per input unit] and loop width [%] by these recordings alone, as in `BaseFigures`.
    """

    changed: bool = False
    gain: Value | None = None
    loops: Value | None = None
    where: tuple[Place, ...] = ()
    confidence: float = 1.0
    measured: dict[str, Value] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Entry in `findings.json`."""
        return {
            "status": "changed" if self.changed else "kept",
            "gain": None if self.gain is None else self.gain.as_dict(),
            "loops": None if self.loops is None else self.loops.as_dict(),
            "where": [asdict(place) for place in self.where],
            "confidence": self.confidence,
            "measured": {name: value.as_dict() for name, value in self.measured.items()},
        }


@dataclass(frozen=True)
class HeldOut:
    """Held-out recording.

    Parameters
    ----------
    before, after
        Rms error of the given and of the extended model, each without its mean [output unit].
    """

    path: str
    sha256: str
    before: float
    after: float


@dataclass(frozen=True)
class Unnamed:
    """Unnamed law: its drivers, memory and errors."""

    drivers: tuple[str, ...]  # one or two of `piezod.model.unnamed_law.DRIVERS`
    memories_s: tuple[float, ...]  # shortest and longest relevant memory, or lags of linear dynamics [s]
    already: bool  # whether it also holds in the identification recordings
    before: float  # before, after: rms error on left-out blocks without and with the law [output unit]
    after: float
    p: float  # probability that a useless law gains as much, over all candidates
    gain: bool = False  # whether it multiplies the stroke of the reading; otherwise it adds to the reading
    formula: str = ""  # short formula with units that predicts as well; empty: none
    modes: tuple[tuple[float, float], ...] = ()  # natural frequency [Hz] and damping ratio [1] of each mode
    linear: bool = False  # whether it is linear dynamics of the command

    def as_dict(self, unit: str) -> dict[str, Any]:
        """Entry in `findings.json`."""
        return {
            "drivers": list(self.drivers),
            "form": "gain" if self.gain else "linear" if self.linear else "added",
            "modes": [{"frequency_Hz": frequency_Hz, "damping_ratio": ratio} for frequency_Hz, ratio in self.modes],
            "formula": self.formula or None,
            "memories_s": list(self.memories_s),
            "scope": "already" if self.already else "since",
            "held_out": {"before": self.before, "after": self.after, "unit": unit},
            "p_value": self.p,
        }


@dataclass(frozen=True)
class Unrecorded:
    """Input that is not recorded, estimated from the residual."""

    size: float  # rms of the gain [1], or rms added to the reading [output unit]
    gain: bool
    keeps_s: float  # duration for which it keeps its value [s]
    fast: float = 0.0  # rms of the fast part of the residual, an upper bound of the noise [output unit]

    def as_dict(self, unit: str) -> dict[str, Any]:
        """Entry in `findings.json`."""
        size = {"value": self.size, "unit": "1" if self.gain else unit}
        return {"size": size, "form": "gain" if self.gain else "added", "keeps_s": self.keeps_s}


@dataclass(frozen=True)
class Findings:
    """Result of a diagnosis.

    Parameters
    ----------
    verdict, words
        Verdict, and the summary in one or two sentences.
    floor, floor_from
        Noise [output unit] and its source: "quiet" (rests) or "repeats"; `UNKNOWN`: `floor` is an upper bound.
    where
        Places at which the given model is wrong.
    effects
        New, changed and gone effects.
    before, after
        Rms error of a simulation with the given and with the written model over the diagnosed recordings, without its
        mean [output unit]; equal if the given model stays.
    nrmse_before, nrmse_after
        Fit as MATLAB's `compare` defines it [%].
    explainable
        Structured share of the squared residual [1]: explained by a flexible model, or dependent on motion or level.
    not_testable
        Effects of usual size that these recordings would not show.
    span
        Widest range of the readings of a diagnosed recording [output unit].
    refitted
        Without findings: error with a refitted hysteresis [output unit]; `after` if that hysteresis is written.
    base
        Change of the stack itself.
    law
        Unnamed law in the written model, included in `after`; None: none.
    recordings
        Path, SHA-256, number of samples and left-out stretches of each recording.
    unrecorded
        Unrecorded input; None: none suspected.
    ended_early
        Whether the time was over before all effects were compared.
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
    kept: tuple[UnchangedEffect, ...] = ()
    base: Base = Base()
    law: Unnamed | None = None
    held_out: tuple[HeldOut, ...] = ()
    recordings: tuple[dict[str, Any], ...] = field(default_factory=tuple)
    unrecorded: Unrecorded | None = None
    ended_early: bool = False

    @property
    def gap_closed(self) -> float | None:
        """Share of the gap to the noise floor that is closed [1]; None without a gap."""
        no_gap = self.before**2 <= (1.0 + NO_GAP) * self.floor**2
        return None if no_gap else gap_closed(self.before, self.after, self.floor)

    @property
    def least(self) -> float:
        """Error of the written model, or of the refitted hysteresis without findings [output unit]."""
        return self.after if self.refitted is None else self.refitted

    @property
    def above_noise(self) -> bool:
        """Whether the error of the written model exceeds the noise."""
        return above_noise(self.after, self.floor, self.span)

    @property
    def noise_is_known(self) -> bool:
        """Whether the recordings show the noise; otherwise `floor` is an upper bound."""
        return self.floor_from != UNKNOWN

    @property
    def noise_text(self) -> str:
        """Noise with its unit, or its upper bound."""
        text = f"{self.floor:.3g} {self.unit}"
        return text if self.noise_is_known else f"unknown, at most {text}"

    def _noise_as_dict(self) -> dict[str, Any]:
        if self.noise_is_known:
            return {"value": self.floor, "unit": self.unit, "from": self.floor_from}
        return {"value": None, "unit": self.unit, "from": None, "at_most": self.floor}

    def as_dict(self) -> dict[str, Any]:
        """Content of `findings.json`, schema "piezod.findings/2"; a reader of "/1" can read it."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "ended_early": self.ended_early,
            "words": self.words,
            "noise_floor": self._noise_as_dict(),
            "where": [asdict(place) for place in self.where],
            "effects": [finding.as_dict(self.unit) for finding in self.effects],
            "kept": [effect.as_dict() for effect in self.kept],
            "base": self.base.as_dict(),
            "fit": {
                "unit": self.unit,
                "held_out": {
                    "before": self.before,
                    "after": self.after,
                    "floor": self.floor,
                    "gap_closed": self.gap_closed,
                },
                "held_out_recordings": [asdict(recording) for recording in self.held_out],
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
