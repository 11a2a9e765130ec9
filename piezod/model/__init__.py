"""The model of a bench: its file, its forward chain and its inverse chain."""

from piezod.model.compensator import Compensator, DirectDrive, make_compensator
from piezod.model.extended_compensator import ExtendedCompensator, acting_effects, refuse
from piezod.model.parameters import Model, dump_model, file_sha256, load_model, save_model
from piezod.model.plant import Plant, run_chain

__all__ = [
    "Compensator",
    "DirectDrive",
    "ExtendedCompensator",
    "Model",
    "Plant",
    "acting_effects",
    "dump_model",
    "file_sha256",
    "load_model",
    "make_compensator",
    "refuse",
    "run_chain",
    "save_model",
]
