"""The chain in plain Python with floats and lists, without a compiler."""

from piezod.operators import ImplicitInverse, PrandtlIshlinskii


class PlainChain:
    """Forward, plan and commit of `operator`, from its present states."""

    def __init__(self, operator: PrandtlIshlinskii) -> None:
        self._r, self._w = (part.tolist() for part in operator.plays)
        self._z = operator.states.tolist()
        self._plays = list(zip(self._r, self._w, strict=True))
        self._zones = list(zip(*(part.tolist() for part in operator.dead_zones), strict=True))
        inverse = ImplicitInverse(operator).packed[-2 * len(self._zones) :].tolist()
        half = len(self._zones)
        self._inverse_zones = list(zip(inverse[:half], inverse[half:], strict=True))

    def forward(self, u: float) -> float:
        """Advance by one sample."""
        return _dead_zones(self._zones, self.commit(u))

    def commit(self, u: float) -> float:
        """Move the plays."""
        v, states = 0.0, self._z
        for i, (r, w) in enumerate(self._plays):
            z = states[i]
            if z > u + r:
                states[i] = z = u + r
            elif z < u - r:
                states[i] = z = u - r
            v += w * z
        return v

    def plan(self, y: float) -> float:
        """Input that would bring the output to `y`."""
        r, w, z = self._r, self._w, self._z
        missing = _dead_zones(self._inverse_zones, y)
        for i in range(len(r)):
            missing -= w[i] * z[i]
        sign = 1.0 if missing >= 0.0 else -1.0
        missing *= sign
        position, slope = z[0], w[0]
        for i in range(1, len(r)):
            kink = z[i] + sign * r[i]
            rise = slope * (kink - position) * sign
            if missing <= rise:
                break
            missing -= rise
            position = kink
            slope += w[i]
        return position + sign * missing / slope


def _dead_zones(zones: list[tuple[float, float]], x: float) -> float:
    y = 0.0
    for r, w in zones:
        beyond = x - r
        if r == 0.0 or (r > 0.0) == (beyond > 0.0):
            y += w * beyond
    return y
