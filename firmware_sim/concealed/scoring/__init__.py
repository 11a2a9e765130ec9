"""Scoring of a study: findings compared with the opened truth, figures, report."""
