"""Options of the identification."""

from dataclasses import dataclass

from piezod.estimation.fit.quadratic_program import Variant
from piezod.operators import EPS


@dataclass(frozen=True)
class Options:
    """Options of the identification.

    Parameters
    ----------
    input, output
        Columns of the recordings.
    plays, zones
        Orders n and m; None: the fewest operators that fit as well as the smooth base. With `orders`: the pair with
        the least held-out error.
    orders
        Whether every pair of orders is fitted and compared, as in the thesis. A given n or m, or variant A, implies it.
    variant
        "A": no play weight negative; "B": no partial sum below eps.
    eps
        Smallest partial sum.
    prune
        Whether operators with negligible weights are removed after a comparison of orders.
    fit_share
        After a comparison of orders: leading share of each recording that is fitted, 0.1 to 0.95; the rest is held out.
    """

    input: str = "voltage_V"
    output: str = "force_N"
    plays: int | None = None
    zones: int | None = None
    orders: bool = False
    variant: Variant = "B"
    eps: float = EPS
    prune: bool = True
    fit_share: float = 0.7
    name: str = "stack"

    @property
    def by_orders(self) -> bool:
        """Whether orders are compared or given, as in the thesis; else the smooth base is reduced."""
        return self.orders or self.plays is not None or self.zones is not None or self.variant == "A"
