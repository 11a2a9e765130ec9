"""Location of the files that come with the program: those of the repository, or their copies in the wheel."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(name: str) -> Path:
    """Path of a file in `config/`, of a checkout or of an installed wheel."""
    return shipped_path(f"config/{name}")


def shipped_path(name: str) -> Path:
    """Path of a file that has this path in the repository, such as `systemd/README.md`."""
    packed = _PACKAGE / "_shipped" / name
    return packed if packed.exists() else _PACKAGE.parent / name
