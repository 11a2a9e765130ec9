"""The sealed truth: packed against accidental reading, and hashed before any diagnosis runs.

`seal.json` holds the time of sealing and the SHA-256 of every sealed file. `open_truth` compares the hashes first.
"""

import base64
import hashlib
import io
import json
import zlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from firmware_sim.concealed.errors import SealError
from firmware_sim.concealed.plant.arrays import Array

TRUTH = "truth.sealed"
SEAL = "seal.json"
SCHEMA = "firmware_sim.concealed.seal/1"


def pack(data: bytes) -> bytes:
    """Sealed form of bytes.

    Parameters
    ----------
    data
        Original bytes.
    """
    return base64.b64encode(zlib.compress(data, 6))


def unpack(data: bytes) -> bytes:
    """Original bytes of a sealed form.

    Parameters
    ----------
    data
        Result of `pack`.
    """
    return zlib.decompress(base64.b64decode(data))


def pack_arrays(arrays: dict[str, Array]) -> bytes:
    """Sealed form of named arrays, in single precision.

    Parameters
    ----------
    arrays
        Arrays of any shape, by name.
    """
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{name: values.astype(np.float32) for name, values in arrays.items()})
    return pack(file.getvalue())


def unpack_arrays(data: bytes) -> dict[str, Array]:
    """Named arrays of a sealed form.

    Parameters
    ----------
    data
        Result of `pack_arrays`.
    """
    with np.load(io.BytesIO(unpack(data)), allow_pickle=False) as file:
        return {name: file[name].astype(np.float64) for name in file.files}


def sealed_arrays(directory: Path, case: str) -> Path:
    """Path of the sealed arrays of a case.

    Parameters
    ----------
    directory
        Folder of the study.
    """
    return directory / "sealed" / f"{case}.sealed"


def write_seal(directory: Path, files: list[Path], **fields: object) -> None:
    """Write the seal over files of a directory.

    Parameters
    ----------
    directory
        Directory of the study, which gets `seal.json`.
    fields
        Further fields of `seal.json`.
    """
    hashes = {str(path.relative_to(directory)): _sha256(path) for path in files}
    made = datetime.now(UTC).isoformat(timespec="microseconds")
    text = json.dumps({"schema": SCHEMA, "made": made, **fields, "sha256": hashes}, indent=1)
    (directory / SEAL).write_text(text + "\n", encoding="utf-8")


def open_truth(directory: Path) -> dict[str, object]:
    """Truth of a study, after a check of its seal.

    Raises
    ------
    SealError
        The seal or a sealed file is missing, or a hash differs.
    """
    try:
        seal = json.loads((directory / SEAL).read_text(encoding="utf-8"))
        hashes = dict(seal["sha256"])
    except (OSError, ValueError, KeyError) as error:
        raise SealError(f"{directory / SEAL}: cannot be read: {error}") from error
    if TRUTH not in hashes:
        raise SealError(f"{directory / SEAL}: does not cover {TRUTH}")
    for name, expected in hashes.items():
        path = directory / name
        if not path.is_file():
            raise SealError(f"{path}: is sealed and missing")
        found = _sha256(path)
        if found != expected:
            raise SealError(f"{path}: has SHA-256 {found}, was sealed as {expected}; the study is void")
    truth: dict[str, object] = json.loads(unpack((directory / TRUTH).read_bytes()))
    return truth


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
