"""All commands, in the order in which `piezod --help` lists them."""

from piezod.cli import demo, setup, running, recordings, models, commissioning, diagnosis, history, study, documentation  # noqa: I001
from piezod.cli.root import app, main

__all__ = [
    "app",
    "commissioning",
    "demo",
    "diagnosis",
    "documentation",
    "history",
    "main",
    "models",
    "recordings",
    "running",
    "setup",
    "study",
]
