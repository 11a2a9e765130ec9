"""One row of the table: a figure, its limit and its target."""

from dataclasses import asdict, dataclass

_COLUMNS = (
    "{benchmark:<10} {what:<43} {figure:>9} {limit:>9} {ratio:>7}  {unit:<5} {target:<13} {verdict:<8} {limit_is}"
)


class NotMeasuredError(Exception):
    """The measurement is not possible on this machine; the message names what is missing."""


@dataclass(frozen=True)
class Row:
    """A figure beside its limit.

    Parameters
    ----------
    benchmark, what
        Which benchmark it belongs to and what was measured.
    unit
        Of figure and limit.
    figure, limit
        Medians over the rounds; None where they could not be had.
    limit_is
        What the limit is.
    most, most_ratio
        The target: highest figure, highest figure / limit.
    note
        What else was measured beside it, or why something is missing.
    """

    benchmark: str
    what: str
    unit: str = ""
    figure: float | None = None
    limit: float | None = None
    limit_is: str = ""
    most: float | None = None
    most_ratio: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """Figure over limit."""
        return self.figure / self.limit if self.figure is not None and self.limit else None

    @property
    def meets(self) -> bool | None:
        """Whether the target is met; None without a target or a figure."""
        pairs = ((self.figure, self.most), (self.ratio, self.most_ratio))
        met = [found <= most for found, most in pairs if found is not None and most is not None]
        return all(met) if met else None

    @property
    def target(self) -> str:
        """The target in words."""
        words = [f"<= {_number(self.most)} {self.unit}".rstrip()] if self.most is not None else []
        words += [f"<= {self.most_ratio:g} x"] if self.most_ratio is not None else []
        return ", ".join(words)

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self) | {"ratio": self.ratio, "meets": self.meets}

    def text(self) -> str:
        """One line, a second one for the note."""
        verdict = {True: "meets", False: "MISSES", None: ""}[self.meets]
        line = _COLUMNS.format(
            benchmark=self.benchmark,
            what=self.what,
            figure=_number(self.figure),
            limit=_number(self.limit),
            ratio="-" if self.ratio is None else f"{self.ratio:.2f}",
            unit=self.unit,
            target=self.target,
            verdict=verdict,
            limit_is=self.limit_is,
        ).rstrip()
        return f"{line}\n{'':<11}{self.note}" if self.note else line


def header() -> str:
    """The header line."""
    names = ("benchmark", "what", "figure", "limit", "ratio", "unit", "target", "verdict")
    return _COLUMNS.format(**{name: name for name in names}, limit_is="limit is").rstrip()


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000 or value == int(value) else f"{value:.3g}"
