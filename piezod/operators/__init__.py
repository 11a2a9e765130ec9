"""Operators with a state, stepped sample by sample. The control loop and the simulation run the same compiled step."""

from piezod.operators.prandtl_ishlinskii import EPS, ImplicitInverse, PrandtlIshlinskii

__all__ = ["EPS", "ImplicitInverse", "PrandtlIshlinskii"]
