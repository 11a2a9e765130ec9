"""The scoring of verdicts against the sealed truth."""
