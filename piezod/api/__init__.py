"""Functions and classes for Python programs and notebooks; `import piezod` offers them."""

from piezod.api.functions import diagnose, identify, read_recording, simulate
from piezod.api.model import Inverse, Model
from piezod.api.model_history import History, history
from piezod.api.results import Diagnosed, Identified
from piezod.effects import EFFECTS
from piezod.recording import Recording

__all__ = [
    "EFFECTS",
    "Diagnosed",
    "History",
    "Identified",
    "Inverse",
    "Model",
    "Recording",
    "diagnose",
    "history",
    "identify",
    "read_recording",
    "simulate",
]
