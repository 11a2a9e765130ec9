"""Residuals of a diagnosis: over their drivers, the command's past, time and frequency."""
