"""Where the files lie that come with the program: `config/` of the repository, or their copy in the wheel."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(name: str) -> Path:
    """Path of `name` in `config/`, from a checkout or from an installed wheel."""
    packed = _PACKAGE / "_shipped" / "config" / name
    return packed if packed.exists() else _PACKAGE.parent / "config" / name
