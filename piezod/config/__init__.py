"""Bench configuration: YAML in, frozen and cross-checked objects out."""

from piezod.config.bench import (
    ArmingConfig,
    BenchConfig,
    RealTimeConfig,
    SignCheckConfig,
    bench_of,
    load_bench,
    model_path,
)
from piezod.config.checked import Section, check, shortened
from piezod.config.comments import comments_of
from piezod.config.edited import edited
from piezod.config.effective import dumped, effective_text, entries
from piezod.config.limits import LimitsConfig, loosened
from piezod.config.schema import bench_schema
from piezod.config.yaml_reader import Document, read_document

__all__ = [
    "ArmingConfig",
    "BenchConfig",
    "Document",
    "LimitsConfig",
    "RealTimeConfig",
    "Section",
    "SignCheckConfig",
    "bench_of",
    "bench_schema",
    "check",
    "comments_of",
    "dumped",
    "edited",
    "effective_text",
    "entries",
    "load_bench",
    "loosened",
    "model_path",
    "read_document",
    "shortened",
]
