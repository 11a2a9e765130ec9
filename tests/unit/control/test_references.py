"""References: tables, files, registers and streams, and their behaviour at the end or without new values."""

import socket
import struct
from pathlib import Path

import numpy as np
import pytest

from piezod.config.reference import FileReference, RegisterReference, StreamReference, WaveformReference
from piezod.config.reference_range import ReferenceRange
from piezod.control.references import (
    DatagramStream,
    Freshness,
    RegisterValue,
    TableReference,
    ValueResult,
    counts_dict,
    file_table,
    make_reference,
    waveform_table,
)
from piezod.errors import BusyError, ConfigurationError
from piezod.excitation import shape
from piezod.recording import Recording, write_csv
from piezod.transport import Reading

MS = 1_000_000
ANY = ReferenceRange(-1e6, 1e6)


def waveform(kind="triangle", **changes):
    values = {"kind": kind, "amplitude_N": 50.0, "offset_N": 100.0, "frequency_Hz": 2.0}
    return WaveformReference(**values | changes)


def values_of(reference, count, first=0):
    return np.array([reference.read(k, k * MS) for k in range(first, first + count)])


@pytest.mark.parametrize("kind", ["triangle", "sine", "staircase", "steps", "multisine"])
def test_every_waveform_stays_within_offset_and_amplitude_and_uses_them(kind):
    values = values_of(waveform_table(waveform(kind), 1000.0), 1000)
    assert values.min() == pytest.approx(50.0, abs=0.2)
    assert values.max() == pytest.approx(150.0, abs=0.2)


@pytest.mark.parametrize("kind", ["triangle", "sine", "staircase", "multisine"])
def test_a_waveform_starts_at_its_low_end(kind):
    assert shape(kind, np.array([0.0]))[0] == pytest.approx(-1.0, abs=1e-3)


def test_a_triangle_reaches_its_top_in_the_middle_of_the_period():
    values = values_of(waveform_table(waveform(), 1000.0), 500)
    assert int(np.argmax(values)) == 250
    np.testing.assert_allclose(np.diff(values[:250]), 100.0 / 250)


def test_a_period_that_is_no_whole_number_of_ticks_repeats_without_a_slip():
    reference = waveform_table(waveform("sine", frequency_Hz=3.0), 1000.0)
    k = np.arange(5000)
    np.testing.assert_allclose(
        values_of(reference, 5000), 100.0 - 50.0 * np.cos(2 * np.pi * 3.0 * k / 1000.0), atol=1e-6
    )


def test_a_table_that_has_ended_gives_its_last_value_and_is_ended():
    reference = TableReference([1.0, 2.0, 3.0])
    reference.start(10)
    assert [reference.read(k, 0) for k in (10, 11, 12)] == [1.0, 2.0, 3.0]
    assert reference.freshness is Freshness.LIVE
    assert reference.read(13, 0) == 3.0
    assert reference.freshness is Freshness.ENDED


def test_a_looped_table_starts_again():
    reference = TableReference([1.0, 2.0, 3.0], loop=True)
    assert values_of(reference, 7).tolist() == [1, 2, 3, 1, 2, 3, 1]


def test_a_waveform_too_fast_for_the_tick_is_refused():
    with pytest.raises(ConfigurationError, match="frequency_Hz is 300, must be at most a quarter of rate_Hz, 250"):
        waveform_table(waveform(frequency_Hz=300.0), 1000.0)


def test_a_waveform_with_too_many_ticks_is_refused():
    with pytest.raises(ConfigurationError, match="shorten duration_s"):
        waveform_table(waveform(duration_s=1e6), 1000.0)


def test_a_column_of_a_recording_is_interpolated_scaled_and_shifted(tmp_path):
    recording = Recording(np.array([5.0, 5.01, 5.03]), {"reference_um": np.array([0.0, 10.0, 30.0])})
    write_csv(recording, tmp_path / "rec.csv")
    config = FileReference(kind="file", path="rec.csv", column="reference_um", scale=2.0, offset_N=7.0)
    reference = file_table(config, 1000.0, tmp_path, ANY)
    np.testing.assert_allclose(values_of(reference, 31), 7.0 + 2.0 * np.arange(31), atol=1e-5)


def test_a_missing_column_is_refused_with_the_names_of_the_others(tmp_path):
    write_csv(Recording(np.array([0.0, 1.0]), {"force_N": np.zeros(2)}), tmp_path / "rec.csv")
    with pytest.raises(ConfigurationError, match="has no column reference_N, has force_N"):
        file_table(FileReference(kind="file", path="rec.csv"), 1000.0, tmp_path, ANY)


def test_a_register_gets_stale_with_an_unchanged_counter_and_live_with_a_new_one():
    reading = Reading()
    reading.reference_N, reading.reference_counter = 12.0, 1
    reference = RegisterValue(reading, RegisterReference(kind="register", stale_after_s=0.5), ANY, counted=True)
    reference.read(0, 900 * MS)
    assert reference.freshness is Freshness.STALE  # the register may hold this value for a year
    reading.reference_counter = 7
    assert reference.read(0, 1000 * MS) == 12.0
    assert reference.freshness is Freshness.LIVE
    reference.read(1, 1499 * MS)
    assert reference.freshness is Freshness.LIVE
    reference.read(2, 1501 * MS)
    assert reference.freshness is Freshness.STALE
    reading.reference_N, reading.reference_counter = 13.0, 2
    assert reference.read(3, 1502 * MS) == 13.0
    assert reference.freshness is Freshness.LIVE


def test_a_register_with_nan_keeps_the_last_value():
    reading = Reading()
    reading.reference_N = 12.0
    reference = RegisterValue(reading, RegisterReference(kind="register"), ANY, counted=False)
    reference.read(0, MS)
    reading.reference_N = float("nan")
    assert reference.read(1, 2 * MS) == 12.0
    reference.read(2, 600 * MS)
    assert reference.freshness is Freshness.STALE


@pytest.fixture(params=["udp", "unix"])
def stream(request, tmp_path):
    if request.param == "udp":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        listen, family, address = f"udp://127.0.0.1:{port}", socket.AF_INET, ("127.0.0.1", port)
    else:
        address = str(tmp_path / "stream")
        listen, family = address, socket.AF_UNIX
    reference = DatagramStream(StreamReference(kind="stream", listen=listen, stale_after_s=0.1), ANY)
    sender = socket.socket(family, socket.SOCK_DGRAM)
    sender.connect(address)
    yield reference, sender
    sender.close()
    reference.close()


def datagram(sequence, value):
    return struct.pack("<QQd", sequence, 0, value)


def test_the_newest_datagram_is_used_and_silence_makes_the_reference_stale(stream):
    reference, sender = stream
    reference.read(0, 0)
    assert reference.freshness is Freshness.STALE
    sender.send(datagram(1, 10.0))
    sender.send(datagram(2, 11.0))
    assert reference.read(1, MS) == 11.0
    assert reference.freshness is Freshness.LIVE
    reference.read(2, 100 * MS)
    assert reference.freshness is Freshness.LIVE
    assert reference.read(3, 102 * MS) == 11.0
    assert reference.freshness is Freshness.STALE


def test_old_repeated_malformed_and_infinite_datagrams_are_refused_and_counted(stream):
    reference, sender = stream
    for message in (
        datagram(5, 50.0),
        datagram(4, 40.0),
        datagram(5, 51.0),
        b"x",
        datagram(6, float("inf")),
        b"y" * 60,
    ):
        sender.send(message)
    assert reference.read(0, MS) == 50.0
    refused = {name: count for name, count in counts_dict(reference.counts).items() if count}
    assert refused == {"accepted": 1, "malformed": 3, "out_of_order": 2}


def test_an_address_in_use_is_busy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        listen = f"udp://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(BusyError, match="cannot be bound"):
            DatagramStream(StreamReference(kind="stream", listen=listen), ANY)


@pytest.mark.parametrize("listen", ["udp://127.0.0.1", "udp://:70000", "tcp://1.2.3.4:5", "relative/path", "udp://h:x"])
def test_an_address_that_is_neither_udp_nor_path_is_refused(listen):
    with pytest.raises(ValueError, match="must be udp://HOST:PORT or an absolute path"):
        StreamReference(kind="stream", listen=listen)


def test_make_reference_builds_what_the_configuration_names():
    kinds = {
        "sine": (waveform("sine"), TableReference),
        "register": (RegisterReference(kind="register"), RegisterValue),
    }
    for config, expected in kinds.values():
        assert isinstance(make_reference(config, 1000.0, Path(), Reading(), ANY, counted=True), expected)


def test_a_table_planned_ahead_repeats_its_end_values_until_the_readings_arrive():
    reference = TableReference([1.0, 2.0, 3.0])
    reference.plan_ahead(lambda values, *, loop: np.append(values, [values[-1]] * 2)[2:], 2)
    reference.start(10)
    read = []
    for tick in range(10, 17):
        read.append((reference.read(tick, 0), reference.ahead))
        live = reference.freshness is Freshness.LIVE
    assert read == [(1, 1), (1, 2), (1, 3), (2, 3), (3, 3), (3, 3), (3, 3)]
    assert live
    reference.read(17, 0)
    assert reference.freshness is Freshness.ENDED


def test_a_loop_planned_ahead_runs_in_once_and_then_repeats_without_a_pause():
    reference = TableReference([1.0, 2.0, 3.0], loop=True)
    reference.plan_ahead(lambda values, *, loop: np.roll(values, -1) if loop else np.append(values, values[-1])[1:], 1)
    reference.start(0)
    read = [(reference.read(tick, 0), reference.ahead) for tick in range(8)]
    assert read == [(1, 1), (1, 2), (2, 3), (3, 1), (1, 2), (2, 3), (3, 1), (1, 2)]


@pytest.mark.parametrize(
    ("value", "says"),
    [(1e300, r"1e\+300 N at 5.01 s, must be at most"), (np.nan, "line 3: reference_N is 'nan', must be a number")],
)
def test_a_file_with_an_absurd_value_between_two_ticks_is_refused(tmp_path, value, says):
    time_s = np.array([5.0, 5.01, 5.02, 5.12])
    write_csv(Recording(time_s, {"reference_N": np.array([1.0, value, 1.0, 1.0])}), tmp_path / "rec.csv")
    with pytest.raises(ConfigurationError, match=says):
        file_table(FileReference(kind="file", path="rec.csv"), 10.0, tmp_path, ANY)


def test_a_register_value_beyond_the_range_is_refused_and_counted():
    reading = Reading()
    allowed = ReferenceRange(0.0, 300.0)
    reference = RegisterValue(reading, RegisterReference(kind="register", stale_after_s=0.5), allowed, counted=True)
    for counter, value in enumerate((10.0, 20.0, 301.0, -1.0)):
        reading.reference_N, reading.reference_counter = value, counter
        reference.idle(counter * MS)
    assert reference.read(4, 4 * MS) == 20.0
    assert (reference.counts[ValueResult.ACCEPTED], reference.counts[ValueResult.OUT_OF_RANGE]) == (1, 2)


def test_a_register_value_that_was_there_before_the_first_reading_is_stale():
    reading = Reading()
    reference = RegisterValue(reading, RegisterReference(kind="register", stale_after_s=0.5), ANY, counted=True)
    reference.idle(0)  # no exchange yet
    reading.reference_N, reading.reference_counter = 200.0, 77
    reference.idle(MS)
    reference.begin()
    reference.read(2, 2 * MS)
    assert reference.freshness is Freshness.STALE
