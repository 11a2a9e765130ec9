"""Bench configuration: reads a YAML file into frozen, cross-checked objects."""

from piezod.config.bench import BenchConfig, load_bench, model_path
from piezod.config.limits import LimitsConfig
from piezod.config.sections import RealTimeConfig
from piezod.config.yaml_reader import read_document

__all__ = [
    "BenchConfig",
    "LimitsConfig",
    "RealTimeConfig",
    "load_bench",
    "model_path",
    "read_document",
]
