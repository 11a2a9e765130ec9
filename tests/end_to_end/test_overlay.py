"""Effects laid over a real recording: nothing laid over changes nothing, and what is laid over is found."""

import itertools
import subprocess
import sys

import numpy as np
import pytest

from piezod.recording import Recording
from tests.benches.emulator import ROOT
from tests.studies.overlaid_effects import OVERLAYS, BaseRecording, overlaid, scaled_overlay, with_room_temperature
from tests.studies.overlay import OverlayRow, Verdict, compared, evenly, summary

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def bare():
    """Ten seconds of a made record: a lagging sine, so that no real recording is needed."""
    time_s = np.arange(2000) / RATE_HZ
    voltage = 1.8 - 1.7 * np.cos(2 * np.pi * 0.7 * time_s)
    output = 12.0 * voltage + 2.0 * np.sin(2 * np.pi * 0.7 * time_s - 0.4)
    return BaseRecording(
        with_room_temperature(Recording(time_s, {"voltage_V": voltage, "x_um": output})), "voltage_V", "x_um", 0.4
    )


def test_a_recording_with_nothing_laid_over_is_as_it_was(bare):
    same = overlaid(bare, {})
    for name, values in bare.recording.channels.items():
        np.testing.assert_allclose(same.channel(name), values, atol=1e-6)


@pytest.mark.parametrize("name", OVERLAYS)
def test_an_effect_is_as_strong_as_was_asked(bare, name):
    made, values, size = scaled_overlay(name, bare, 3.0)
    assert name == "sensor_dropout" or size == pytest.approx(3.0, rel=0.1)
    assert OVERLAYS[name].parameter == "from_s" or OVERLAYS[name].parameter in values
    assert not np.array_equal(made.channel("x_um"), bare.recording.channel("x_um")) or name == "electrical_lag"


def test_a_delayed_record_shows_the_output_of_before(bare):
    made = overlaid(bare, {"transport_delay": {"delay_s": 0.02}})
    late = made.channel("x_um")[1000:]
    np.testing.assert_allclose(late, bare.recording.channel("x_um")[996:-4], atol=1e-3)


def test_a_lag_is_what_turns_the_recorded_command_into_the_voltage_that_acted(bare):
    made = overlaid(bare, {"electrical_lag": {"time_constant_s": 0.02}})
    command, acted = made.channel("voltage_V"), bare.recording.channel("voltage_V")
    keep, output = np.exp(-1.0 / RATE_HZ / 0.02), acted[0]
    lagged = []
    for one, following in itertools.pairwise(command):
        output = keep * output + (1.0 - keep) * 0.5 * (one + following)
        lagged.append(output)
    np.testing.assert_allclose(lagged[200:], acted[201:], atol=5e-3)


def test_a_pause_is_left_out_and_the_rest_put_on_equal_steps():
    time_s = np.concatenate([np.arange(100) * 0.01, 3.0 + np.arange(400) * 0.01 + 0.002 * (np.arange(400) % 2)])
    made = evenly(Recording(time_s, {"x_um": time_s}), None)
    assert made.time_s[-1] == pytest.approx(3.99, abs=0.02)
    np.testing.assert_allclose(made.channel("x_um"), 3.0 + made.time_s, atol=2e-3)
    assert evenly(Recording(time_s, {"x_um": time_s}), 1.0).time_s[-1] == pytest.approx(1.0, abs=0.02)


def said(**effects):
    parameters = {name: {"delay_s": {"value": value, "low": value, "high": value}} for name, value in effects.items()}
    return Verdict("explained", parameters, ("resonance",), 1.0, 0.1, 0.1, 1.0)


@pytest.mark.parametrize(
    ("with_it", "without_it", "found"),
    [
        (said(transport_delay=0.0105), said(), True),
        (said(transport_delay=0.013), said(), False),  # a wrong delay
        (said(creep=1.0), said(), False),
        (said(transport_delay=0.01), said(transport_delay=0.01), False),  # the bench had it before
    ],
)
def test_found_is_a_name_that_comes_in_addition_with_its_parameter(with_it, without_it, found):
    row = compared("bench", "transport_delay", {"delay_s": 0.01}, 3.0, with_it, without_it)
    assert row.found is found
    assert row.extra == (("creep",) if "creep" in with_it.named else ())
    named = "transport_delay" in with_it.named
    words = summary([OverlayRow("bench", "none", found=True), row])
    assert words.startswith(f"{int(found)} of 1 found, {int(named)} named, {len(row.extra)} extra names")


@pytest.mark.parametrize(("option", "name"), [("--only", "gremlins"), ("--bench", "gremlins")])
def test_an_unknown_name_is_refused(option, name):
    command = [sys.executable, "-m", "tests.studies", "overlay", option, name]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "is called gremlins" in done.stderr
