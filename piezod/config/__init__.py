"""Bench configuration: reads a YAML file into frozen, cross-checked objects."""

from piezod.config.bench import BenchConfig, bench_of, load_bench, model_path
from piezod.config.checked import Section, check, shortened
from piezod.config.comments import comments_of
from piezod.config.effective import all_values, effective_text, entries
from piezod.config.limits import LimitsConfig, loosened_limit
from piezod.config.schema import bench_schema
from piezod.config.sections import ArmingConfig, DriftConfig, RealTimeConfig, SignCheckConfig
from piezod.config.value_edit import replace_values
from piezod.config.yaml_reader import Document, read_document

__all__ = [
    "ArmingConfig",
    "BenchConfig",
    "Document",
    "DriftConfig",
    "LimitsConfig",
    "RealTimeConfig",
    "Section",
    "SignCheckConfig",
    "all_values",
    "bench_of",
    "bench_schema",
    "check",
    "comments_of",
    "effective_text",
    "entries",
    "load_bench",
    "loosened_limit",
    "model_path",
    "read_document",
    "replace_values",
    "shortened",
]
