"""Parameters of a model with their intervals: effects, gain and loop width of the stack."""

from collections.abc import Sequence
from dataclasses import dataclass

from piezod.diagnose.findings import Value
from piezod.diagnose.verdict.evidence import given_values
from piezod.diagnose.verdict.words import PER, label_of
from piezod.effects import EFFECTS
from piezod.model import Model
from piezod.model.base_figures import base_figures
from piezod.model.parameters import BASE

GAIN, LOOP_WIDTH = "gain", "loop_width_percent"
ASSUMED = {GAIN: 0.01, LOOP_WIDTH: 0.05}  # half of a 95 % interval that a file does not state, relative to the value


@dataclass(frozen=True)
class Key:
    """Name of a parameter: of an effect of the catalogue, or of the base."""

    effect: str
    parameter: str

    def __str__(self) -> str:
        """Name in JSON and CSV."""
        return f"{self.effect}.{self.parameter}"

    @property
    def title(self) -> str:
        """Title of the effect; the base is the stack."""
        return "stack" if self.effect == BASE else EFFECTS[self.effect].title

    def label(self, unit: str) -> str:
        """Name of the parameter without its unit."""
        return label_of(self.parameter, "percent" if unit == "%" else unit)

    def heading(self, unit: str) -> str:
        """Title and label, such as "creep of the stack per decade" or "stack: gain"."""
        label = self.label(unit)
        return f"{self.title} {label}" if label.startswith(PER) else f"{self.title}: {label}"


def parameters_of(model: Model, driven: tuple[float, float] | None = None) -> dict[Key, Value]:
    """Parameters with 95 % intervals; an interval of an effect that the model does not state is the value itself.

    An effect of a single recording is omitted, because it is no property of the bench.

    Parameters
    ----------
    driven
        Range of the input for the figures of the base [input unit]; None: the range of the model.
    """
    low, high = driven or (model.input.low, model.input.high)
    figures = base_figures(model.hysteresis, low, high)
    gain_unit = f"{model.output.unit}/{model.input.unit}"
    values = {
        Key(BASE, name): _base_value(model, name, value, unit)
        for name, value, unit in ((GAIN, figures.gain, gain_unit), (LOOP_WIDTH, figures.loop_width_percent, "%"))
    }
    for entry in model.effects:
        if entry.recording is None:
            known = EFFECTS[entry.name]
            values |= {
                Key(entry.name, name): value
                for name, value in given_values(model, entry.name).items()
                if not known.parameter(name).instant
            }
    return values


def assumed_intervals(model: Model) -> list[str]:
    """Figures of the base without an interval in the file, as in files of older versions."""
    return [] if model.information is not None else list(ASSUMED)


def assumed_words(names: Sequence[str]) -> str:
    """Note on figures of the base without an interval."""
    listed = ", ".join(f"{100.0 * ASSUMED[name]:g} % of {Key(BASE, name)}" for name in names)
    return f"intervals that the file does not state, as in files of older versions, are assumed: {listed}"


def _base_value(model: Model, name: str, value: float, unit: str) -> Value:
    """Figure of the base with its interval; the interval of another range of the input is scaled."""
    if model.information is None:
        low, high = 1.0 - ASSUMED[name], 1.0 + ASSUMED[name]
    else:
        ends = getattr(model.information, name)
        low, high = (2.0 * end / (ends[0] + ends[1]) for end in ends)
    return Value(value, unit, value * low, value * high)
