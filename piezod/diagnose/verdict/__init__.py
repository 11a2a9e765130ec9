"""Verdict: evidence for each effect, wording, and the extended model."""
