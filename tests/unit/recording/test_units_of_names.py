"""Units at the end of channel names."""

import pytest

from piezod.recording.names import unit_of


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("force_N", "N"),
        ("slew_V_per_s", "V_per_s"),
        ("velocity_cm_s", "cm_per_s"),
        ("feed_mm_min", "mm_per_min"),
        ("acceleration_m_s2", "m_per_s2"),
        ("turn_deg_s", "deg_per_s"),
        ("dead_time_s", "s"),
        ("force", ""),
    ],
)
def test_the_unit_of_a_name(name, unit):
    assert unit_of(name) == unit
