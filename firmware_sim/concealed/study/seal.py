"""The sealed truth: packed so that no one reads it by accident, and hashed before anything is run.

`seal.json` holds the SHA-256 of every sealed file and when it was made. Opening compares the hashes first.
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
    """Sealed form of some bytes."""
    return base64.b64encode(zlib.compress(data, 6))


def unpack(data: bytes) -> bytes:
    """What was sealed."""
    return zlib.decompress(base64.b64decode(data))


def pack_arrays(arrays: dict[str, Array]) -> bytes:
    """Sealed form of some arrays, in single precision."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **{name: values.astype(np.float32) for name, values in arrays.items()})
    return pack(file.getvalue())


def unpack_arrays(data: bytes) -> dict[str, Array]:
    """The arrays that were sealed."""
    with np.load(io.BytesIO(unpack(data)), allow_pickle=False) as file:
        return {name: file[name].astype(np.float64) for name in file.files}


def sealed_arrays(directory: Path, case: str) -> Path:
    """Where a case's sealed arrays are."""
    return directory / "sealed" / f"{case}.sealed"


def write_seal(directory: Path, files: list[Path], **said: object) -> None:
    """Write the seal over files of a directory.

    Parameters
    ----------
    directory
        Where `seal.json` goes.
    files
        What is sealed.
    said
        What else the seal says.
    """
    hashes = {str(path.relative_to(directory)): _sha256(path) for path in files}
    made = datetime.now(UTC).isoformat(timespec="microseconds")
    text = json.dumps({"schema": SCHEMA, "made": made, **said, "sha256": hashes}, indent=1)
    (directory / SEAL).write_text(text + "\n", encoding="utf-8")


def open_truth(directory: Path) -> dict[str, object]:
    """The truth of a study whose seal is whole.

    Raises
    ------
    SealError
        There is no seal, a sealed file is missing, or its hash is another.
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
