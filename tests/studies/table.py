"""One row of the study's table."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

_COLUMNS = (
    "{effect:<26} {size:>6} {named:<34} {exact:<5} {parameter:<22} {true:>8} {found:>9} {error:>7}  {verdict:<16} "
    "{before:>7} {after:>7} {floor:>6} {seconds:>5}"
)


@dataclass(frozen=True)
class Row:
    """Result of one scenario.

    Parameters
    ----------
    effect
        The active effect.
    size
        Root mean square of its change in this record, over the noise.
    named
        Effects that the diagnosis names.
    exact
        Whether exactly the active effect is named.
    parameter, true, found
        Compared parameter, its true and found value; None without a comparison.
    alike
        Whether the emulated physics has the parameter in the catalogue's sense.
    verdict
        Of the diagnosis.
    before, after, floor
        Error on blocks left out with the given and the extended model, and the noise [N].
    seconds
        That the diagnosis took.
    rivals
        Named as rivals of what was named.
    why
        What went wrong on the way, where something did.
    """

    effect: str
    size: float | None = None
    named: tuple[str, ...] = ()
    exact: bool = False
    parameter: str = ""
    true: float | None = None
    found: float | None = None
    alike: bool = True
    verdict: str = "failed"
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    seconds: float | None = None
    rivals: tuple[str, ...] = ()
    why: str = ""

    @property
    def error_percent(self) -> float | None:
        """Error of the parameter [%]; None where it is not the same quantity."""
        if self.true is None or self.found is None or not self.alike:
            return None
        return 100.0 * (self.found / self.true - 1.0)

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self) | {"error_percent": self.error_percent}

    def text(self) -> str:
        """One line, and a second one for an error."""
        error = self.error_percent
        line = _COLUMNS.format(
            effect=self.effect,
            size="-" if self.size is None else f"{self.size:.1f}",
            named=", ".join(self.named) or "-",
            exact="yes" if self.exact else "NO",
            parameter=self.parameter,
            true=_number(self.true),
            found=_number(self.found),
            error="-" if error is None else f"{error:+.1f}%",
            verdict=self.verdict,
            before=_number(self.before),
            after=_number(self.after),
            floor=_number(self.floor),
            seconds="-" if self.seconds is None else f"{self.seconds:.0f}",
        ).rstrip()
        notes = [f"rivals: {', '.join(self.rivals)}"] if self.rivals and not self.exact else []
        notes += [self.why] if self.why else []
        return "\n".join([line, *(f"{'':<27}{note}" for note in notes)])


def header() -> str:
    """The header line."""
    names = ("effect", "size", "named", "exact", "parameter", "true", "found", "error", "verdict")
    return _COLUMNS.format(
        **{name: name for name in names}, before="before", after="after", floor="floor", seconds="s"
    ).rstrip()


def summary(rows: Sequence[Row]) -> str:
    """The summary line."""
    wrong = [row.effect for row in rows if not row.exact]
    not_exact = f"; not: {', '.join(wrong)}" if wrong else ""
    return f"{len(rows) - len(wrong)} of {len(rows)} exact{not_exact}. size: in noise rms; before, after, floor in N"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
