"""The list of faults of `faults.yaml`, read strictly: an unknown key, injector or parameter is an error."""

import inspect
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from piezod.config.checked import Section, check
from piezod.config.yaml_reader import read_document

LIST = Path(__file__).with_name("faults.yaml")
COUNTS = {"T": 26, "P": 45, "M": 11, "V": 29, "C": 17, "R": 30, "D": 14, "S": 32}
UNITS_MS = {"ms": 1.0, "s": 1000.0}

StateName = Literal["DISARMED", "ARMING", "RUNNING", "HOLD", "RAMP_DOWN", "FAULT", "none"]


class Bound(Section):
    """Allowed range of a figure; at least one bound is given."""

    least: float | None = None
    most: float | None = None

    @model_validator(mode="after")
    def _binds(self) -> "Bound":
        if self.least is None and self.most is None:
            raise ValueError("needs least, most, or both")
        return self

    def holds(self, value: float) -> bool:
        """Whether a value is within the bounds."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)


class Expected(Section):
    """The expected result of a fault.

    Parameters
    ----------
    state
        Final state; `A or B` allows both; `none`: without a bench.
    exit_code
        Exit code of the command.
    says
        Texts that the log or the message must contain, in upper or lower case.
    figures
        Allowed ranges of figures by name.
    """

    state: Annotated[str, Field(pattern=r"^[A-Z_]+( or [A-Z_]+)*$|^none$")] | None = None
    exit_code: int | None = None
    says: Annotated[tuple[str, ...], Field(strict=False)] = ()
    figures: Annotated[dict[str, Bound], Field(default_factory=dict)]

    @model_validator(mode="after")
    def _expects_something(self) -> "Expected":
        if self.state is None and self.exit_code is None and not self.says and not self.figures:
            raise ValueError("needs a state, an exit_code, says or figures")
        return self

    @property
    def states(self) -> tuple[str, ...]:
        """The allowed final states."""
        return () if self.state is None else tuple(self.state.split(" or "))


class Fault(Section):
    """One fault of the list.

    Parameters
    ----------
    id
        T1 to S12; the letter is the group.
    fault
        Short description.
    inject
        `by` names the injector; the other keys are its parameters.
    expect
        The expected result.
    within
        Limit of the time from the fault to the first safe state, or to the end of the command: a number and ms or s.
    logged
        Cause that the log must contain; the text of a latched fault.
    instead
        Why the injection or the expected result differs from the description.
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
        """Name of the injector."""
        return str(self.inject["by"])

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the injector."""
        return {name: value for name, value in self.inject.items() if name != "by"}


class FaultList(Section):
    """The content of `faults.yaml`."""

    schema_: Annotated[Literal["piezod.faults/1"], Field(alias="schema")]
    faults: Annotated[tuple[Fault, ...], Field(strict=False)]

    @model_validator(mode="after")
    def _is_whole(self) -> "FaultList":
        """Check that each id occurs once, in order."""
        wanted = [f"{letter}{number}" for letter, count in COUNTS.items() for number in range(1, count + 1)]
        found = [fault.id for fault in self.faults]
        if found != wanted:
            missing = [name for name in wanted if name not in found]
            double = sorted({name for name in found if found.count(name) > 1})
            raise ValueError(f"faults: missing {missing}, twice {double}; each id must occur once, in order")
        return self


def load_faults(
    injectors: Mapping[str, Callable[..., Any]], path: Path = LIST, simulated: Collection[str] = ()
) -> tuple[Fault, ...]:
    """Read the list: the faults of these injectors; those of an injector that is simulated only are left out.

    Raises
    ------
    ConfigurationError
        The file is not valid; the message names file, line, key, value and limit.
    ValueError
        An injector or one of its parameters does not exist.
    """
    elsewhere = {*simulated} - {*injectors}
    faults = tuple(one for one in check(read_document(path), FaultList).faults if one.inject.get("by") not in elsewhere)
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
