"""The concealed study: draws cases with a sealed truth, diagnoses them without the truth, and scores the verdicts."""
