"""Bench configuration: YAML in, frozen and cross-checked objects out."""

from piezod.config.bench import ArmingConfig, BenchConfig, RealTimeConfig, SignCheckConfig, load_bench, model_path
from piezod.config.checked import Section, check, shortened
from piezod.config.limits import LimitsConfig, loosened
from piezod.config.yaml_reader import Document, read_document

__all__ = [
    "ArmingConfig",
    "BenchConfig",
    "Document",
    "LimitsConfig",
    "RealTimeConfig",
    "Section",
    "SignCheckConfig",
    "check",
    "load_bench",
    "loosened",
    "model_path",
    "read_document",
    "shortened",
]
