"""The model of a bench: its file, its forward chain and its inverse."""

from piezod.model.chain.acting import acting_effects, refuse_uncompensated, without_inverse
from piezod.model.chain.forward import decays_of, run_chain
from piezod.model.compensator import Compensator, DirectDrive, make_compensator
from piezod.model.extended_compensator import ExtendedCompensator
from piezod.model.model_file import dump_model, file_sha256, load_model, model_sha256, save_model
from piezod.model.parameters import Model
from piezod.model.reach import steady_range

__all__ = [
    "Compensator",
    "DirectDrive",
    "ExtendedCompensator",
    "Model",
    "Plant",
    "acting_effects",
    "decays_of",
    "dump_model",
    "file_sha256",
    "load_model",
    "make_compensator",
    "model_sha256",
    "refuse_uncompensated",
    "run_chain",
    "save_model",
    "steady_range",
    "without_inverse",
]
