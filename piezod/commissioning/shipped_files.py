"""Location of the files that come with the program: `config/` of the repository, or its copy in the wheel."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(name: str) -> Path:
    """Path of a file in `config/`, of a checkout or of an installed wheel."""
    packed = _PACKAGE / "_shipped" / "config" / name
    return packed if packed.exists() else _PACKAGE.parent / "config" / name
