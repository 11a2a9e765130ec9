"""The list of faults of `faults.yaml`, read strictly: an unknown key, injector or parameter is an error."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from piezod.config.checked import Section, check
from piezod.config.yaml_reader import read_document

LIST = Path(__file__).with_name("faults.yaml")
ROOMS = {"T": 23, "P": 17, "M": 10, "V": 14, "C": 11, "R": 15, "D": 8, "S": 12}
UNITS_MS = {"ms": 1.0, "s": 1000.0}

StateName = Literal["DISARMED", "ARMING", "RUNNING", "HOLD", "RAMP_DOWN", "FAULT", "none"]


class Bound(Section):
    """What a figure may be."""

    least: float | None = None
    most: float | None = None

    @model_validator(mode="after")
    def _binds(self) -> "Bound":
        if self.least is None and self.most is None:
            raise ValueError("needs least, most, or both")
        return self

    def holds(self, value: float) -> bool:
        """Whether a figure is within."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)


class Expected(Section):
    """What must come of the fault.

    Parameters
    ----------
    state
        The state that it ends in; `none` where nothing is driven. Two words: either.
    exit_code
        Of the command.
    says
        What must stand in the log or the message, whatever the case of its letters.
    figures
        What was counted, and what it may be.
    """

    state: Annotated[str, Field(pattern=r"^[A-Z_]+( or [A-Z_]+)*$|^none$")] | None = None
    exit_code: int | None = None
    says: Annotated[tuple[str, ...], Field(strict=False)] = ()
    figures: Annotated[dict[str, Bound], Field(default_factory=dict)]

    @model_validator(mode="after")
    def _expects_something(self) -> "Expected":
        if self.state is None and self.exit_code is None and not self.says and not self.figures:
            raise ValueError("needs a state, an exit_code, says or figures: a fault that nothing is expected of")
        return self

    @property
    def states(self) -> tuple[str, ...]:
        """The states, any of which will do."""
        return () if self.state is None else tuple(self.state.split(" or "))


class Fault(Section):
    """One row.

    Parameters
    ----------
    id
        As in the list of faults: T1 to S12.
    fault
        What it is.
    inject
        `by` names the injector; the other keys are its parameters.
    expect
        What must come of it.
    within
        From the fault to the first safe state, or to the end of the command: a number and ms or s.
    logged
        The cause that must stand in the log; the same as the text of a latched fault.
    instead
        What is expected instead of what the list of faults says, and why.
    """

    id: Annotated[str, Field(pattern=r"^[TPMVCRDS][0-9]{1,2}$")]
    fault: Annotated[str, Field(min_length=5)]
    inject: dict[str, Any]
    expect: Expected
    within: Annotated[str, Field(pattern=r"^[0-9.]+ (ms|s)$")]
    logged: str | None = None
    instead: Annotated[str, Field(min_length=20)] | None = None

    @property
    def within_ms(self) -> float:
        """The bound [ms]."""
        number, unit = self.within.split()
        return float(number) * UNITS_MS[unit]

    @property
    def injector(self) -> str:
        """Its name."""
        return str(self.inject["by"])

    @property
    def parameters(self) -> dict[str, Any]:
        """What the injector is given."""
        return {name: value for name, value in self.inject.items() if name != "by"}


class FaultList(Section):
    """The file."""

    schema_: Annotated[Literal["piezod.faults/1"], Field(alias="schema")]
    faults: Annotated[tuple[Fault, ...], Field(strict=False)]

    @model_validator(mode="after")
    def _is_whole(self) -> "FaultList":
        """Every row of the list of faults stands here once, in its order."""
        wanted = [f"{room}{number}" for room, most in ROOMS.items() for number in range(1, most + 1)]
        found = [fault.id for fault in self.faults]
        if found != wanted:
            missing = [name for name in wanted if name not in found]
            double = sorted({name for name in found if found.count(name) > 1})
            raise ValueError(f"faults: missing {missing}, twice {double}; every one must stand there, in order")
        return self


def load_faults(injectors: Mapping[str, Callable[..., Any]], path: Path = LIST) -> tuple[Fault, ...]:
    """Read the list.

    Raises
    ------
    ConfigurationError
        One line: file, line, key, value, what it must be.
    ValueError
        An injector that does not exist, or a parameter that it does not take.
    """
    faults = check(read_document(path), FaultList).faults
    for fault in faults:
        where = f"{path.name}: {fault.id}.inject"
        if fault.inject.get("by") not in injectors:
            raise ValueError(f"{where}.by is {fault.inject.get('by')!r}, must be one of {', '.join(sorted(injectors))}")
        try:
            inspect.signature(injectors[fault.injector]).bind(None, fault, **fault.parameters)
        except TypeError as error:
            raise ValueError(f"{where}: {fault.injector}: {error}") from None
    return faults


__all__ = ["Bound", "Expected", "Fault", "load_faults"]
