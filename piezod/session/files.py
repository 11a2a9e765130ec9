"""Digest of the files that a control process loads besides its bench configuration."""

import hashlib
from pathlib import Path

from piezod.config import BenchConfig, model_path
from piezod.config.reference import MOST_BYTES, FileReference
from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError


def files_digest(bench: BenchConfig, path: Path) -> str:
    """Digest of the content of the model file, and of the reference file if there is one.

    A file that cannot be read counts as empty; loading it reports the error.
    """
    digest = hashlib.sha256()
    files = [model_path(bench, path)]
    if isinstance(bench.reference, FileReference):
        files.append(path.parent / bench.reference.path)
    for file in files:
        try:
            with open_regular(file, MOST_BYTES) as opened:
                content = opened.read()
        except (OSError, ConfigurationError):
            content = b""
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()
