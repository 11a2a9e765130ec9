"""The `drift` section: how a bench that leaves its model is noticed, and how much of it is kept."""

from typing import Annotated

from pydantic import Field

from piezod.config.checked import Section


class DriftConfig(Section):
    """What is measured against what the model expects, window by window, and the stretch kept when they part.

    `beyond_N` is the difference [N] that counts as drift; None: three times the model's own held-out error.
    """

    window_s: Annotated[float, Field(ge=1, le=3600)] = 10.0
    beyond_N: Annotated[float, Field(gt=0)] | None = None
    keep_s: Annotated[float, Field(ge=10, le=3600)] = 120.0
    file: str | None = None
