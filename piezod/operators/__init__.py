"""Per-sample state machines, compiled once: the same step serves the tick and the simulation."""

from piezod.operators.prandtl_ishlinskii import EPS, AnalyticInverse, ImplicitInverse, PrandtlIshlinskii

__all__ = ["EPS", "AnalyticInverse", "ImplicitInverse", "PrandtlIshlinskii"]
