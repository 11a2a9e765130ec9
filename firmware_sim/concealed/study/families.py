"""Families of plants, which differ in what they are: the law of the hysteresis, and of each effect that has several.

A rule of a diagnosis is chosen on some families and tested on another one. The laws stand in `plant/`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from firmware_sim.concealed.plant.hysteresis import Kind
from firmware_sim.concealed.study.entry import Context

RATE_WINDOW_S = (0.002, 0.02)
STRIBECK = (1.05, 1.3)  # static over sliding friction


@dataclass(frozen=True)
class Family:
    """Laws of a family.

    Parameters
    ----------
    creep, rate, friction
        Laws of these effects: of `creep.LAWS`, `stroke.RATE_LAWS` and `friction.LAWS`.
    in_front
        Whether the load cell stands in front of the guide, where the friction has the other sign.
    dropout
        What a reading does that drops out: of `sampling.DROPOUTS`.
    with_rate
        Kind of the operator where the rate widens it; a Preisach plane has no widths to widen.
    not_compared
        Parameters by effect that mean another thing under these laws.
    """

    hysteresis: Kind
    creep: str
    rate: str
    friction: str
    in_front: bool
    dropout: str
    with_rate: Kind
    not_compared: Mapping[str, tuple[str, ...]] = field(
        default_factory=lambda: {"rate_dependent_hysteresis": ("growth", "reference_V_per_s")}
    )

    def details(self, name: str, rng: np.random.Generator, bench: Context) -> dict[str, object]:
        """Details of an effect under these laws; empty where the family has none of its own."""
        laws: dict[str, dict[str, object]] = {
            "creep": {"law": self.creep},
            "rate_dependent_hysteresis": {
                "law": self.rate,
                "window_s": float(np.exp(rng.uniform(*np.log(RATE_WINDOW_S)))),
                "fastest_V_per_s": bench.lasting_V_per_s,
            },
            "friction": {
                "law": self.friction,
                "in_front": self.in_front,
                "static": rng.uniform(*STRIBECK),
                "slow_N_per_s": float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))) * bench.full_N,
                "seed": int(rng.integers(2**31)),
            },
            "sensor_dropout": {"manner": self.dropout},
        }
        return laws.get(name, {})


FAMILIES = {
    "preisach": Family(
        "preisach", "logarithmic", "averaged", "maxwell", in_front=False, dropout="noisy", with_rate="plays"
    ),
    "bouc_wen": Family("bouc_wen", "kelvin", "averaged", "lugre", in_front=True, dropout="rail", with_rate="bouc_wen"),
    "plays": Family("plays", "fractional", "linear", "maxwell", in_front=False, dropout="noisy", with_rate="plays"),
    "interpolated": Family(
        "interpolated",
        "diffusion",
        "logarithmic",
        "elasto_plastic",
        in_front=True,
        dropout="exact",
        with_rate="bouc_wen",
    ),
}
"""The families, by the law of their hysteresis."""
