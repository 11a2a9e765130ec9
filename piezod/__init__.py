"""piezod: feedforward force control for piezo stacks, and the instrument that finds what its model left out.

    recording = piezod.read_recording("triangles.csv")
    model = piezod.identify(recording).model
    found = piezod.diagnose("work.csv", model)

`piezod/api/README.md` describes the functions.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from piezod.runtime.compiled_code import provide_folder

if TYPE_CHECKING:
    from piezod.api import (
        EFFECTS,
        Diagnosed,
        History,
        Identified,
        Inverse,
        Model,
        Recording,
        diagnose,
        history,
        identify,
        read_recording,
        simulate,
    )

    __version__: str

__all__ = [
    "EFFECTS",
    "Diagnosed",
    "History",
    "Identified",
    "Inverse",
    "Model",
    "Recording",
    "__version__",
    "diagnose",
    "history",
    "identify",
    "read_recording",
    "simulate",
]

provide_folder()  # before numba is imported, which reads the environment once

# Packages have the names of three functions. Python binds a package here once, when it is first imported: now.
for _name in ("diagnose", "history", "identify"):
    import_module(f"piezod.{_name}")
    del globals()[_name]


def __getattr__(name: str) -> object:
    """A name of the interface; its room is imported when the name is asked for, so that commands start at once."""
    if name == "__version__":
        return import_module("importlib.metadata").version("piezod-bench")
    if name in __all__:
        return getattr(import_module("piezod.api"), name)
    raise AttributeError(f"module 'piezod' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Names for completion."""
    return sorted(__all__)
