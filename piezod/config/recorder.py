"""The `recorder` section: where every tick is kept, and how much of the disk that may take."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from piezod.config.checked import Section


class RecorderConfig(Section):
    """Files of ticks in one folder, the oldest given up for the newest."""

    folder: Annotated[str, Field(min_length=1)]
    sync_every_s: Annotated[float, Field(ge=0.05, le=60)] = 0.5
    file_MB: Annotated[float, Field(ge=8, le=100_000)] = 256.0
    file_h: Annotated[float, Field(gt=0, le=8760)] = 24.0
    folder_MB: Annotated[float, Field(ge=16)] = 10_000.0

    @model_validator(mode="after")
    def _two_files_fit(self) -> Self:
        if self.folder_MB < 2 * self.file_MB:
            raise ValueError(
                f"folder_MB is {self.folder_MB:g}, must be at least two files of file_MB, {2 * self.file_MB:g}: "
                "while one is written, one is kept"
            )
        return self
