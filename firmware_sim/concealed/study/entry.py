"""One entry of the catalogue: how an effect is drawn, and the bench figures that its ranges depend on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.record_context import Effect

RAMP_SAMPLES = 4  # a slew limit that acts for fewer samples looks like a lag

ALREADY_THERE, COME_SINCE = "already_there", "come_since"
EITHER = (ALREADY_THERE, COME_SINCE)


@dataclass(frozen=True)
class Context:
    """Figures of the bench and of its first recording that set the range of an effect.

    Parameters
    ----------
    reach_V, full_N
        Ranges of voltage [V] and force [N].
    rate_Hz
        Rate of the readings [1/s].
    noise_N
        Rms of the noise [N].
    duration_s
        Duration of the first recording [s].
    fastest_V_per_s
        Largest rate of its commands from one sample to the next [V/s].
    lasting_V_per_s
        Largest mean rate of its commands over `RAMP_SAMPLES` [V/s].
    """

    reach_V: float
    full_N: float
    rate_Hz: float
    noise_N: float
    duration_s: float
    fastest_V_per_s: float
    lasting_V_per_s: float

    @property
    def period_s(self) -> float:
        """Sample period [s]."""
        return 1.0 / self.rate_Hz


Draw = Callable[[np.random.Generator, Context], tuple[dict[str, float], dict[str, object]]]


@dataclass(frozen=True)
class Entry:
    """How one effect is drawn.

    Parameters
    ----------
    scale
        Parameter that sets the strength; with a leading `:`, a detail.
    bounds
        Smallest and largest plausible value of `scale`.
    draw
        Draws the other parameters and the details.
    scopes
        Allowed scopes. An effect that a static model would absorb can only have come since the identification.
    straight
        True: needs commands that are not held. Held commands would define its parameter to one sample only.
    signed
        True: `scale` is a size; its sign is drawn.
    plausible
        Tests the effect once its strength is known.
    """

    scale: str
    bounds: Callable[[Context], tuple[float, float]]
    draw: Draw
    scopes: tuple[str, ...] = EITHER
    straight: bool = False
    signed: bool = False
    plausible: Callable[[Effect], bool] = lambda effect: True  # noqa: ARG005

    def effect(self, name: str, scope: str, drawn: tuple[dict[str, float], dict[str, object]], scale: float) -> Effect:
        """Build the effect from its drawn values and the value of `scale`."""
        parameters, details = dict(drawn[0]), dict(drawn[1])
        sign = -1.0 if self.signed and details.pop("negative") else 1.0
        if self.scale.startswith(":"):
            details[self.scale[1:]] = scale
        else:
            parameters[self.scale] = sign * scale
        return Effect(name, parameters, details, scope)
