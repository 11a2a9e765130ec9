"""piezod: feedforward force control for piezo stacks, and the instrument that finds what its model left out."""

from importlib.metadata import version

__version__ = version("piezod-bench")
