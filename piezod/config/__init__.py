"""Bench configuration: YAML in, frozen and cross-checked objects out."""

from piezod.config.bench import BenchConfig, RealTimeConfig, load_bench, model_path
from piezod.config.checked import Section, check
from piezod.config.limits import LimitsConfig
from piezod.config.yaml_reader import Document, read_document

__all__ = [
    "BenchConfig",
    "Document",
    "LimitsConfig",
    "RealTimeConfig",
    "Section",
    "check",
    "load_bench",
    "model_path",
    "read_document",
]
