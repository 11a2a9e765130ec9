"""Adequacy: the explainable part of the residual."""
