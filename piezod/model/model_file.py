"""The model file `model.yaml`: identification and diagnosis write it, simulation and control read it.

A file that is read and written again keeps its text.
"""

import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from piezod.config import read_document
from piezod.config.checked import check, shortened
from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError, ModelError
from piezod.model.parameters import Model
from piezod.runtime.files import written

SCHEMA = "piezod.model/1"


def load_model(path: Path) -> Model:
    """Read and check a model file.

    Raises
    ------
    ConfigurationError
        A value is wrong; the message names file, line, key, value and limit.
    ModelError
        The schema differs, or the model has no inverse.
    """
    document = read_document(path, SCHEMA.encode())
    schema = document.content.get("schema")
    if schema != SCHEMA:
        raise ModelError(f"{path}: schema is {shortened(schema)}, must be '{SCHEMA}'; identify again with this version")
    model = check(document, Model)
    try:
        model.operator()
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    return model


def dump_model(model: Model) -> str:
    """Text of the model file of `model`."""
    content = model.model_dump(by_alias=True, exclude_none=True)
    if not model.effects:
        del content["effects"]
    if model.sampling == "straight":
        del content["sampling"]
    if model.sampling != "held":
        del content["read_after"]
    for key in ("diagnosed", "changes"):
        if not content["provenance"][key]:
            del content["provenance"][key]
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def save_model(model: Model, path: Path) -> None:
    """Write a model file; a failed write leaves an existing file unchanged.

    Raises
    ------
    ConfigurationError
        The file cannot be written, or the path names a file that is no model.
    """
    _refuse_other_file(path)
    written(path, dump_model(model))


def _refuse_other_file(path: Path) -> None:
    """Refuse to replace a file that is no model, such as a recording that `-o` names by mistake."""
    try:
        with open_regular(path, sys.maxsize) as file:
            head = file.read(4096)
    except (ConfigurationError, OSError):
        return  # nothing is there, or the write reports the error
    if head and b"piezod.model/" not in head:
        raise ConfigurationError(f"{path}: exists and is no model file; name another file")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as `Provenance` stores it.

    Returns
    -------
    64 hexadecimal digits.
    """
    with open_regular(path, sys.maxsize) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def model_sha256(model: Model) -> str:
    """SHA-256 of the file that `save_model` writes, 64 hexadecimal digits."""
    return hashlib.sha256(dump_model(model).encode()).hexdigest()


class _Dumper(yaml.SafeDumper):
    """YAML writer: lists of numbers in one line, floats with all their digits."""


def _represent_list(dumper: yaml.SafeDumper, values: Sequence[object]) -> yaml.Node:
    flow = all(isinstance(value, (int, float)) for value in values) and bool(values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    return dumper.represent_scalar(
        "tag:yaml.org,2002:float",
        np.format_float_scientific(value, trim="0", exp_digits=1)
        if value != 0 and not 1e-4 <= abs(value) < 1e16
        else repr(value),
    )


_Dumper.add_representer(tuple, _represent_list)
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(float, _represent_float)
