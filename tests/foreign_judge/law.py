"""A second simulation of a `model.yaml` as judge of `piezod simulate`: plain numpy, written from the pages alone.

Its equations stand in `piezod/effects/README.md` and `piezod/operators/README.md`. It imports nothing of piezod.
"""

import math
from itertools import pairwise

import numpy as np


class Course:
    """Signal between samples: straight (`read_after` None), or held and read `read_after` samples after its command."""

    def __init__(self, t, dt, read_after):
        self.t, self.dt, self.read_after = t, dt, read_after

    def run(self, x, state, ramp, jump=lambda state, _: state):
        """States at the readings: `ramp(state, a, b, h)` moves a state, `jump(state, dx)` is a step of x."""
        states = [state]
        for a, b in pairwise(x):
            if self.read_after is None:
                state = ramp(state, a, b, self.dt)
            else:
                if self.read_after < 1.0:
                    state = ramp(state, a, a, (1.0 - self.read_after) * self.dt)
                state = ramp(jump(state, b - a), b, b, self.read_after * self.dt)
            states.append(state)
        return np.array(states)


def first_order(tau):
    """Step of tau y' + y = x, for x straight from a to b in the time h."""

    def ramp(y, a, b, h):
        lag = (b - a) / h * tau
        return b - lag + (y - a + lag) * math.exp(-h / tau)

    return ramp


def second_order(w, zeta):
    """Step of y'' + 2 zeta w y' + w^2 y = w^2 x for a straight x; the state is (y, y')."""
    root = w * np.sqrt(complex(zeta**2 - 1.0) if zeta != 1.0 else 1e-12)

    def ramp(state, a, b, h):
        slope = (b - a) / h
        lag = 2.0 * zeta / w
        e, de = state[0] - (a - slope * lag), state[1] - slope
        p, q = -zeta * w + root, -zeta * w - root
        share = (de - q * e) / (p - q)
        fast, slow = share * np.exp(p * h), (e - share) * np.exp(q * h)
        return np.array([b - slope * lag + (fast + slow).real, slope + (p * fast + q * slow).real])

    return ramp


def voltage_clamp(u, v, course, _):
    limit, knee = v["limit_V"], v["knee_V"]
    return np.where(np.abs(u - limit) < knee, u - (u - limit + knee) ** 2 / (4.0 * knee), np.minimum(u, limit))


def slew_limit(u, v, course, _):
    limit = v["limit_V_per_s"]

    def ramp(y, a, b, h):
        """Towards x at the limit until x is met; then with x, as far as the limit allows."""
        slope, way = (b - a) / h, np.sign(a - y) or np.sign(b - a)
        closing = limit * way - slope
        met = (a - y) / closing if closing * way > 0.0 else h
        if met >= h:
            return y + limit * way * h
        return a + slope * met + np.clip(slope, -limit, limit) * (h - met)

    return course.run(u, u[0], ramp)


def electrical_lag(u, v, course, _):
    y, out = u[0], [u[0]]
    for pair in pairwise(u):
        tau = v["time_constant_s"] * max(0.2, 1.0 + v["swell"] * (y - 60.0) / 100.0)
        y = course.run(np.array(pair), y, first_order(tau))[1]
        out.append(y)
    return np.array(out)


def widening(u, v, course, model):
    """Factor and offset of the thresholds at each sample."""
    rates, rate, rested, over_way = [0.0], 0.0, 0.0, v["rate_over"] == 0
    for du in np.abs(np.diff(u)):
        rested += course.dt
        if over_way and du > 0.0:
            duration = rested if rested <= 0.05 else course.dt
            rate -= math.expm1(-du / v["rate_way_V"]) * (du / duration - rate)
            rested = 0.0
        elif not over_way:
            rate -= math.expm1(-course.dt / v["rate_memory_s"]) * (du / course.dt - rate)
        rates.append(rate)
    grown = np.log1p(np.array(rates) / v["reference_V_per_s"])
    if v["kind"] == 1:
        return np.exp(v["growth"] * grown), 0.0 * grown
    if v["kind"] == 2:
        return 1.0 + 0.0 * grown, v["growth"] * grown * (model["input"]["high"] - model["input"]["low"]) / 10.0
    return 1.0 + v["growth"] * grown, 0.0 * grown


def plays(u, thresholds, factor, offset):
    r0, states = np.asarray(thresholds), [np.zeros(len(thresholds))]
    for value, f, o in zip(u, factor, offset, strict=True):
        r = np.where(r0 > 0.0, r0 * f + o, 0.0)
        states.append(np.maximum(value - r, np.minimum(value + r, states[-1])))
    return np.array(states[1:])


def dead_zones(x, table):
    pairs = zip(table["thresholds"], table["weights"], strict=True)
    return sum(w * (np.maximum(x - r, 0.0) if r > 0.0 else np.minimum(x - r, 0.0) if r else x) for r, w in pairs)


def bouc_wen(x, travel, exponent, closing):
    """State z over an input x, from 0: fine steps of Runge and Kutta. A movement by `travel` takes z from 0 to 63 %."""
    z = np.linspace(0.0, 1.0 - math.exp(-1.0), 20001)
    reach = float(np.sum(np.diff(z) / (1.0 - ((z[1:] + z[:-1]) / 2.0) ** exponent)))

    def slope(z, way):
        power = abs(z) ** exponent
        return way * (1.0 - power if z * way >= 0.0 else 1.0 - (1.0 - 2.0 * closing) * power)

    z, out = 0.0, [0.0]
    for ds in np.diff(x) * reach / travel:
        steps = max(1, math.ceil(abs(ds) / 0.005))
        h, way = abs(ds) / steps, np.sign(ds)
        for _ in range(steps):
            k1 = slope(z, way)
            k2 = slope(z + h / 2 * k1, way)
            k3 = slope(z + h / 2 * k2, way)
            k4 = slope(z + h * k3, way)
            z = min(1.0, max(-1.0, z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)))
        out.append(z)
    return np.array(out)


def noncongruent_minor_loops(x, v, course, chain):
    u, s = chain["u"], chain["model"]["input"]["high"] - chain["model"]["input"]["low"]
    states = plays(u, s * ((np.arange(24) + 0.5) / 24) ** 1.5, np.ones(u.size), np.zeros(u.size))
    hats = np.maximum(0.0, 1.0 - np.abs(np.arange(24)[:, None] / 23 * 3 - np.arange(4)))
    total = np.zeros(u.size)
    for d in range(1, 6):
        polynomial = np.polynomial.chebyshev.Chebyshev.basis(d)
        inside, input_ = polynomial(2.0 * states / s - 1.0), polynomial(2.0 * u / s - 1.0)
        w = hats @ np.array([v[f"degree_{d}_{j}"] for j in range(4)])
        total += (inside - input_[:, None]) @ w / 24
        total += v.get(f"curve_{d}", 0.0) * (input_ - polynomial(-1.0))
    b = bouc_wen(u, 0.3 * s * v["memory_way"], v["memory_exponent"], v["memory_closing"])
    return x + s / 2 * v["share"] * (total - v["memory"] * b)


def creep(x, v, course, chain):
    begin, end, driver = v["from_s"], max(v["to_s"], 3.0 * v["from_s"]), x
    count = max(3, math.ceil(4 * math.log10(end / begin)) + 1)
    taus = np.geomspace(begin, end, count)
    weights = np.full(count, math.log(end / begin) / (count - 1))
    weights[0], weights[-1] = weights[0] / 2 + 0.596, weights[-1] / 2 + 1.260
    weights *= math.log10(end / begin) / (weights @ (np.exp(-begin / taus) - np.exp(-end / taus)))
    middle = math.sqrt(begin * max(min(end, chain["model"].get("seen_s", course.t[-1])), 3.0 * begin))
    weights *= v["per_decade"] * (taus / middle) ** v["slope"]
    if v["driven_by"] == 1:
        driver, course = chain["u"] * sum(chain["model"]["hysteresis"]["plays"]["weights"]), chain["applied"]
    for tau, weight in zip(taus, weights, strict=True):
        x = x + weight * course.run(driver - driver[0], 0.0, first_order(tau))
    return x


def gain_drift(x, v, course, _):
    p, b = course.t / course.t[-1], v["bend"]
    q = p - v["s_shape"] * np.sin(2 * np.pi * p) / (2 * np.pi)
    return x * (1.0 + v["relative_change"] * (np.expm1(-b * q) / np.expm1(-b) if b else q))


def output_nonlinearity(force, v, course, chain):
    a, b, span = v["curvature"], v["cubic"], chain["model"]["output"]["high"] - chain["model"]["output"]["low"]
    ends = [-np.inf, np.inf]  # slope: 1 + 2 (a - b) f / span + 3 b f^2 / span^2
    for root in np.roots([3 * b / span**2, 2 * (a - b) / span, 0.95]):
        if abs(root.imag) < 1e-12:
            ends = [max(ends[0], root.real), ends[1]] if root.real < 0 else [ends[0], min(ends[1], root.real)]
    f = np.clip(force, *ends)
    return f + a * f**2 / span + b * f**2 * (f - span) / span**2 + 0.05 * (force - f)


def contact_gap(force, v, course, _):
    way, soft = force - v["gap_N"], v["softness_N"]
    return np.where(np.abs(way) < soft, (way + soft) ** 2 / (4.0 * soft or 1.0), np.maximum(0.0, way))


def friction(force, v, course, _):
    return force - v["force_N"] * bouc_wen(force, v["presliding_N"], v["exponent"], v["closing"])


def thermal_drift(force, v, course, chain):
    lagged, straight = chain["temperature"], Course(course.t, course.dt, None)
    lagged = straight.run(lagged, lagged[0], first_order(v["lag_s"])) if v["lag_s"] else lagged
    return force + v["coefficient_N_per_K"] * (lagged - lagged[0])


def load_step(force, v, course, _):
    rise, off = max(v["rise_s"], course.dt), max(v["on_s"], v["off_s"])
    on, over = (np.clip((course.t - at) / rise, 0.0, 1.0) for at in (v["on_s"], off))
    return force + v["step_N"] * (on - over)


def resonance(force, v, course, _):
    ramp = second_order(2.0 * math.pi * v["frequency_Hz"], v["damping_ratio"])
    return course.run(force, np.array([force[0], 0.0]), ramp)[:, 0]


def vibration(force, v, course, _):
    breathing = np.sin(2 * np.pi * course.t / v["breathing_period_s"] + v["breathing_phase_rad"])
    tone = np.sin(2 * np.pi * v["frequency_Hz"] * course.t + v["phase_rad"])
    return force + v["amplitude_N"] * (1.0 + v["breathing_depth"] * breathing) * tone


def charge_leakage(force, v, course, _):
    return force - course.run(force, force[0], first_order(v["time_constant_s"])) + force[0]


def sensor_filter(force, v, course, _):
    if v["order"] == 1:
        return course.run(force, force[0], first_order(0.5 / (math.pi * v["cutoff_Hz"])))
    m = 1.0 - 2.0 * v["damping_ratio"] ** 2
    w = 2.0 * math.pi * v["cutoff_Hz"] / math.sqrt(m + math.hypot(m, 1.0))
    return course.run(force, np.array([force[0], 0.0]), second_order(w, v["damping_ratio"]))[:, 0]


def feedthrough(force, v, course, chain):
    k, rise, applied = v["coefficient_N_s_per_V"], v["rise_s"], chain["applied"]

    def ramp(y, a, b, h):
        return k * (b - a) / h + (y - k * (b - a) / h) * math.exp(-h / rise)

    return force + applied.run(chain["u"], 0.0, ramp, lambda y, du: y + k * du / rise)


def mains_hum(force, v, course, _):
    a = 2.0 * np.pi * v["frequency_Hz"] * course.t + v["phase_rad"]
    overtones = sum(v[f"sine_{h}"] * np.sin(h * a) + v[f"cosine_{h}"] * np.cos(h * a) for h in range(2, 8))
    return force + v["amplitude_N"] * (np.sin(a) + overtones)


def later(force, v, course, _):
    """Transport delay or clock skew."""
    return np.interp(course.t * (1.0 + v.get("skew_ppm", 0.0) * 1e-6) - v.get("delay_s", 0.0), course.t, force)


def sensor_dropout(force, v, course, _):
    stuck = (course.t >= v["from_s"]) & (course.t < v["to_s"])
    return np.where(stuck, np.interp(v["from_s"], course.t, force), force)


def quantisation(force, v, course, _):
    return v["offset_N"] + v["step_N"] * np.floor((force - v["offset_N"]) / v["step_N"] + 0.5)


SMOOTH = ("slew_limit", "electrical_lag", "resonance", "sensor_filter")  # behind them a signal counts as straight
AMPLIFIER = {one.__name__: one for one in (voltage_clamp, slew_limit, electrical_lag)}
STACK = {one.__name__: one for one in (noncongruent_minor_loops, creep, gain_drift)}
BEHIND = (output_nonlinearity, contact_gap, friction, thermal_drift, load_step, resonance, vibration)
BEHIND = {one.__name__: one for one in (*BEHIND, charge_leakage, sensor_filter, feedthrough, mains_hum)}
BEHIND |= {
    "transport_delay": later,
    "clock_skew": later,
    "sensor_dropout": sensor_dropout,
    "quantisation": quantisation,
}


def simulate(model, t, u, temperature=None):
    """Reading [unit of the output] of a model (its file, parsed) over a command u at the times t."""
    values = {one["name"]: one["parameters"] for one in model["effects"]}
    read_after = {"straight": None, "held_before": 1.0}.get(model["sampling"], model.get("read_after"))
    course = Course(t - t[0], (t[-1] - t[0]) / (t.size - 1), read_after)
    chain = {"model": model, "temperature": temperature}
    if model["sampling"] == "held_before":  # a reading shows the command before
        u = np.concatenate((u[:1], u[:-1]))

    def act(steps, signal, course):
        for name, step in steps.items():
            if name in values:
                signal = step(signal, values[name], course, chain)
                course = Course(course.t, course.dt, None) if name in SMOOTH else course
        return signal, course

    u, course = act(AMPLIFIER, u, course)
    chain |= {"u": u, "applied": course}
    wider = values.get("rate_dependent_hysteresis")
    factor, offset = widening(u, wider, course, model) if wider else (np.ones(u.size), np.zeros(u.size))
    hysteresis, by_force = model["hysteresis"], values.get("creep", {}).get("driven_by") == 2
    stroke = plays(u, hysteresis["plays"]["thresholds"], factor, offset) @ np.array(hysteresis["plays"]["weights"])
    stroke, course = act({k: one for k, one in STACK.items() if k != "creep" or not by_force}, stroke, course)
    force = dead_zones(stroke, hysteresis["dead_zones"]) + hysteresis["offset"]
    return act(({"creep": creep} if by_force else {}) | BEHIND, force, course)[0]
