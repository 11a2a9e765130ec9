import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_sim.physics.layout import REVERSALS, STATE
from firmware_sim.physics.parameters import parameter_record
from firmware_sim.physics.preisach import everett, move_field
from firmware_sim.physics.scenario import Scenario, load_scenario

FULL_V = 140.0
voltages = st.floats(0.0, FULL_V, allow_nan=False, width=32)


class Plane:
    """The compiled plane, moved from one input to the next."""

    def __init__(self, share=0.0):
        effects = {"noncongruent_minor_loops": {"share": share}} if share else {}
        scenario = load_scenario("stack", {"effects": effects})
        self.parameters = parameter_record(scenario, np.random.default_rng(0))
        self.state = np.zeros(1, STATE)

    def move(self, *fields_V):
        for field_V in fields_V:
            move_field(self.state[0], self.parameters[0], field_V)
        return float(self.state["irreversible"][0])

    def loop_width(self, low_V, high_V):
        """Force of the loop between two voltages, half way, falling less rising."""
        self.move(high_V, low_V)
        rising = self.move(0.5 * (low_V + high_V))
        self.move(high_V)
        return self.move(0.5 * (low_V + high_V)) - rising


class RelayPlane:
    """Relays on a grid, each switched by its own two thresholds: the definition, at the cost of its cells."""

    def __init__(self, parameters, cells=560):
        edge = np.linspace(-FULL_V, FULL_V, cells + 1)
        centre = 0.5 * (edge[1:] + edge[:-1])
        self.up, self.down = np.meshgrid(centre, centre, indexing="ij")
        width, area = self.up - self.down, (edge[1] - edge[0]) ** 2
        by_width = parameters["width_weight"] / (1.0 + (width / parameters["width_scale_V"]) ** 2)
        place = parameters["bias_scale_V"]
        by_place = 1.0 / (1.0 + (self.up / place) ** 2) / (1.0 + (self.down / place) ** 2)
        density = by_width + parameters["bias_weight"] * by_place
        self.weight = np.where(width > 0.0, density, np.where(width == 0.0, 0.5 * density, 0.0)) * area
        self.on = (self.up + self.down < 0.0).astype(float)
        self.on[self.up + self.down == 0.0] = 0.5
        self.rest = np.sum(self.weight * self.on)

    def move(self, field_V):
        self.on[self.up < field_V] = 1.0
        self.on[self.down > field_V] = 0.0
        return np.sum(self.weight * self.on) - self.rest


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_everett_evaluation_agrees_with_a_grid_of_relays(share):
    plane = Plane(share)
    relays = RelayPlane(plane.parameters[0])
    path_V = [140.0, 35.0, 90.0, 50.0, 75.0, 20.0, 60.0, 0.0, 120.0, 30.5, 30.0, 31.0]
    path_V += [-20.0, 10.0, -80.0, 30.0, -139.5, 100.0, -110.0, 139.5, -139.9, 0.0]
    path_V += list(np.random.default_rng(5).uniform(0.0, 140.0, 15))
    full = plane.parameters[0]["full_V"] * Scenario().stack.irreversible
    errors = [abs(plane.move(field_V) - relays.move(field_V)) for field_V in path_V]
    assert max(errors) < 0.01 * full  # one row of relays is 0.5 V of 140 V wide


def test_a_swing_beyond_the_greatest_one_so_far_is_back_on_the_virgin_curve():
    plane, reference = Plane(), Plane()
    assert plane.move(60.0, -90.0) == pytest.approx(reference.move(-90.0), abs=1e-9)
    assert plane.state["reversals"][0] == 0


@given(st.lists(voltages, min_size=1, max_size=12), st.sampled_from([0.0, 0.4]))
@settings(max_examples=60)
def test_a_return_to_the_outer_reversal_wipes_out_all_within(inner_V, share):
    straight, wandering = Plane(share), Plane(share)
    inside = [20.0 + 90.0 * field_V / FULL_V for field_V in inner_V]
    assert straight.move(120.0, 20.0, 110.0) == pytest.approx(
        wandering.move(120.0, 20.0, *inside, 20.0, 110.0), abs=1e-9
    )
    assert straight.move(5.0, 130.0, 60.0) == pytest.approx(wandering.move(5.0, 130.0, 60.0), abs=1e-9)
    assert straight.state["reversals"][0] == wandering.state["reversals"][0]


@given(st.lists(voltages, min_size=2, max_size=10))
@settings(max_examples=40)
def test_the_path_taken_in_small_steps_ends_where_one_step_does(corners_V):
    coarse, fine = Plane(0.3), Plane(0.3)
    for start, end in zip([0.0, *corners_V], corners_V, strict=False):
        fine.move(*np.linspace(start, end, 7)[1:-1], end)
    assert coarse.move(*corners_V) == pytest.approx(fine.move(), abs=1e-9)


@given(voltages, voltages)
def test_the_output_never_falls_while_the_input_rises(first_V, second_V):
    plane = Plane(0.5)
    before = plane.move(100.0, first_V)
    after = plane.move(second_V)
    assert (after - before) * (second_V - first_V) >= 0.0


def test_minor_loops_between_equal_widths_are_congruent_by_default():
    widths = [Plane().loop_width(low_V, low_V + 30.0) for low_V in (5.0, 55.0, 105.0)]
    assert widths[0] > 0.1
    np.testing.assert_allclose(widths, widths[0], rtol=1e-9)


def test_minor_loops_depend_on_bias_with_the_noncongruent_share():
    low, high = (Plane(0.4).loop_width(low_V, low_V + 30.0) for low_V in (5.0, 105.0))
    assert low > 1.1 * high


def test_loops_between_equal_extrema_are_congruent_whatever_came_before():
    plain, after_history = Plane(0.4), Plane(0.4)
    after_history.move(140.0, 0.0, 100.0, 10.0, 95.0)
    assert after_history.loop_width(40.0, 80.0) == pytest.approx(plain.loop_width(40.0, 80.0), rel=1e-9)


def test_the_virgin_curve_ends_at_full_scale_for_any_share():
    expected = 0.42 * FULL_V
    for share in (0.0, 0.3, 1.0):
        assert Plane(share).move(FULL_V) == pytest.approx(expected, rel=1e-12)


def test_the_everett_function_is_the_integral_of_the_density():
    parameters = Plane().parameters[0]
    width = np.linspace(0.0, 80.0, 20_001)
    density = parameters["width_weight"] / (1.0 + (width / parameters["width_scale_V"]) ** 2)
    expected = np.trapezoid(density * (80.0 - width), width)
    assert everett(parameters, 20.0, 100.0) == pytest.approx(expected, rel=1e-7)


def test_a_full_memory_forgets_its_smallest_loop_and_keeps_the_largest():
    plane, reference = Plane(), Plane()
    for index in range(2 * REVERSALS):
        plane.move(70.0 + (60.0 - 0.1 * index) * (-1.0) ** index)
    expected = reference.move(130.0, 10.0, 131.0, 65.0)
    assert plane.move(10.0, 131.0, 65.0) == pytest.approx(expected, abs=1e-9)
