"""piezod: feedforward force control for piezo stacks, and the instrument that finds what its model left out.

    recording = piezod.read_recording("triangles.csv")
    model = piezod.identify(recording).model
    found = piezod.diagnose("work.csv", model)

`piezod/api/README.md` describes the functions.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezod.api import (
        EFFECTS,
        Diagnosed,
        Identified,
        Inverse,
        Model,
        Recording,
        diagnose,
        identify,
        read_recording,
        simulate,
    )

    __version__: str

__all__ = [
    "EFFECTS",
    "Diagnosed",
    "Identified",
    "Inverse",
    "Model",
    "Recording",
    "__version__",
    "diagnose",
    "identify",
    "read_recording",
    "simulate",
]


class _Package(ModuleType):
    """The package `piezod`: its names are imported when they are asked for, so that commands and daemon start at once.

    `identify` and `diagnose` are the functions. The import system binds the packages of the same names here, which is
    ignored: `from piezod.identify import ...` finds them by their paths.
    """

    @property
    def identify(self) -> object:
        """The function."""
        return import_module("piezod.api").identify

    @identify.setter
    def identify(self, _package: object) -> None: ...

    @property
    def diagnose(self) -> object:
        """The function."""
        return import_module("piezod.api").diagnose

    @diagnose.setter
    def diagnose(self, _package: object) -> None: ...

    def __getattr__(self, name: str) -> object:
        """Any other name of the interface."""
        if name == "__version__":
            return import_module("importlib.metadata").version("piezod-bench")
        if name in __all__:
            return getattr(import_module("piezod.api"), name)
        raise AttributeError(f"module 'piezod' has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        """Names for completion."""
        return sorted(__all__)


sys.modules[__name__].__class__ = _Package
