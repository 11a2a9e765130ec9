"""Proof test of a bench (`piezod check --proof`): its trips, the watchdog of its device and a stop, at low voltage."""

from piezod.commissioning.proof.sequence import STEPS, prove

__all__ = ["STEPS", "prove"]
