"""Functions and classes for Python programs and notebooks; `import piezod` offers them."""

from piezod.api.functions import diagnose, identify, read_recording, simulate
from piezod.api.model import Inverse, Model
from piezod.api.results import Diagnosed, Identified
from piezod.effects import EFFECTS
from piezod.recording import Recording

__all__ = [
    "EFFECTS",
    "Diagnosed",
    "Identified",
    "Inverse",
    "Model",
    "Recording",
    "diagnose",
    "identify",
    "read_recording",
    "simulate",
]
