"""Varied benches: their drives, and how they begin, offset and record."""

import hashlib
import json

import numpy as np
import pytest

from firmware_sim.concealed.plant.foreign import FOREIGN, ForeignContext
from firmware_sim.concealed.plant.identification_drives import AMID, IDENTIFICATIONS
from firmware_sim.concealed.plant.second_input import SECOND_INPUTS
from firmware_sim.concealed.plant.work_drives import WORKS, driven_work
from firmware_sim.concealed.scoring.case_score import HeldOut, gap_closed
from firmware_sim.concealed.study.bench import MOST_ROWS, VARIED_RATES_HZ, draw_varied_bench
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.make import make
from firmware_sim.concealed.study.plan import VARIED_SHARES, case_specs
from firmware_sim.concealed.study.seal import open_truth
from firmware_sim.concealed.study.truth import TrueCase, TrueEffect, read_truth
from tests.unit.firmware_sim.concealed.benches import FULL_N, REACH_V, drive, effect, forces, straight_plant, triangles

KINDS = {**IDENTIFICATIONS, **WORKS}
EXTENTS = [(250.0, 20.0), (1000.0, 60.0), (10_000.0, 12.0)]
SEEDS = range(6)
USUAL_TRUTHS = {"null": "6f76b672", "single": "61d20296", "foreign": "5970d0df"}  # SHA-256, first eight digits


def runs_of(levels):
    """Lengths of the holds, in samples."""
    edges = np.flatnonzero(np.diff(levels, prepend=np.nan) != 0.0)
    return np.diff(np.append(edges, levels.size))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("rate_Hz", "duration_s"), EXTENTS)
def test_a_drive_starts_at_rest_stays_in_the_range_and_fits_its_duration(kind, rate_Hz, duration_s):
    for seed in SEEDS:
        levels, lead = KINDS[kind](np.random.default_rng(seed), rate_Hz, duration_s)
        assert levels[0] == 0.0
        assert levels.min() >= 0.0
        assert levels.max() <= 1.0 + 1e-12
        assert 0 <= lead < 0.5 * levels.size
        longest = round(duration_s * rate_Hz)
        assert levels.size <= longest
        assert kind == "repeated sine" or levels.size >= longest - 1


@pytest.mark.parametrize("kind", IDENTIFICATIONS)
@pytest.mark.parametrize(("rate_Hz", "duration_s"), EXTENTS)
def test_an_identification_covers_the_range_slowly(kind, rate_Hz, duration_s):
    for seed in SEEDS:
        levels, lead = IDENTIFICATIONS[kind](np.random.default_rng(seed), rate_Hz, duration_s)
        assert levels[lead:].max() > 0.85
        if kind != "staircase":
            assert np.abs(np.diff(levels)).max() * rate_Hz < 12.0  # ranges per second


def test_a_staircase_holds_every_tread_and_returns_to_zero():
    levels, _ = IDENTIFICATIONS["staircase"](np.random.default_rng(2), 1000.0, 60.0)
    treads = levels[1:][np.diff(levels) == 0.0]
    assert treads.size > 0.8 * levels.size
    assert levels[-1] == 0.0
    assert np.sort(runs_of(levels))[-12:].min() > 200


def test_a_decaying_sine_ends_with_a_small_part_of_its_first_amplitude():
    for seed in SEEDS:
        levels, lead = IDENTIFICATIONS["decaying sine"](np.random.default_rng(seed), 500.0, 60.0)
        part = (levels.size - lead) // 20
        assert np.ptp(levels[-part:]) < 0.2 * np.ptp(levels[lead:])


def test_a_repeated_sine_has_two_or_three_equal_periods():
    found = set()
    for seed in range(12):
        levels, lead = IDENTIFICATIONS["repeated sine"](np.random.default_rng(seed), 500.0, 60.0)
        written = levels[lead:]
        equal = [
            n for n in (2, 3) if written.size % n == 0 and np.allclose(written, np.roll(written, written.size // n))
        ]
        assert equal
        found.add(equal[0])
    assert found == {2, 3}


def test_strokes_rest_near_zero_and_press_to_varying_peaks():
    levels, _ = WORKS["press strokes"](np.random.default_rng(3), 1000.0, 60.0)
    assert np.mean(levels < 0.1) > 0.1
    tops = levels[1:-1][(levels[1:-1] > levels[:-2]) & (levels[1:-1] >= levels[2:]) & (levels[1:-1] > 0.45)]
    assert np.unique(np.round(tops, 6)).size > 10


def test_a_load_spectrum_has_many_small_cycles_and_few_large_ones():
    shares = []
    for seed in SEEDS:
        levels, _ = WORKS["load spectrum"](np.random.default_rng(seed), 1000.0, 120.0)
        turns = levels[1:-1][np.diff(np.sign(np.diff(levels))) != 0]
        swings = np.abs(np.diff(turns))
        shares.append(np.mean(swings[swings > 0.01] > 0.5 * swings.max()))
    assert np.mean(shares) < 0.5


def test_half_of_the_broadband_work_is_two_exact_periods_and_none_passes_a_fifth_of_the_rate():
    periodic = 0
    for seed in range(20):
        levels, lead = WORKS["broadband"](np.random.default_rng(seed), 1000.0, 20.0)
        written = levels[lead:]
        half = written.size // 2
        periodic += written.size % 2 == 0 and np.allclose(written[:half], written[half:])
        clipped = np.any((written == 0.0) | (written == 1.0))  # clipped noise has harmonics
        power = np.abs(np.fft.rfft(written - written.mean())) ** 2
        above = power[np.fft.rfftfreq(written.size) > 0.201].sum() / power.sum()
        assert above < (0.02 if clipped else 1e-9)
    assert 5 <= periodic <= 15


@pytest.mark.parametrize("kind", [kind for kind in WORKS if kind != "broadband"])
def test_work_that_is_not_broadband_keeps_the_rate_limit(kind):
    levels, _ = driven_work(kind, np.random.default_rng(1), 1000.0, 30.0, 2.0)
    assert np.abs(np.diff(levels)).max() * 1000.0 <= 2.0 + 1e-9


def test_varied_benches_have_every_rate_kind_and_hold_and_at_most_120_000_rows():
    benches = [draw_varied_bench(np.random.default_rng(seed), straight=seed % 2 == 0) for seed in range(100)]
    assert {bench.rate_Hz for bench in benches} == set(VARIED_RATES_HZ)
    assert {bench.truth["identification"] for bench in benches} == set(IDENTIFICATIONS)
    assert {bench.truth["work"] for bench in benches} == set(WORKS)
    assert {bench.held for bench in benches} == {True, False}
    assert not any(bench.held for bench in benches[::2])
    assert max(record.drive.voltage_V.size for bench in benches for record in bench.records) <= MOST_ROWS
    gains = [bench.voltmeter.gain for bench in benches]
    assert 0.995 <= min(gains) < 0.999
    assert 1.001 < max(gains) <= 1.005
    noises = [bench.voltmeter.noise_V / bench.reach_V for bench in benches]
    assert 0.0002 <= min(noises) < max(noises) <= 0.002


def test_every_record_of_a_varied_bench_has_its_own_tare_and_some_begin_amid_the_range():
    benches = [draw_varied_bench(np.random.default_rng(seed), straight=True) for seed in range(60)]
    for bench in benches:
        tares_N = [record.tare_N for record in bench.records]
        assert len(set(tares_N)) == len(tares_N)
        assert max(map(abs, tares_N)) <= 0.5 * bench.full_N
        assert bench.records[-1].begin_s == 0.0
        assert bench.records[0].begin_s == 0.0 or bench.truth["identification"] in AMID
    begun = [any(r.begin_s > 0.0 for r in bench.records if r.name.startswith("recording")) for bench in benches]
    assert 8 <= sum(begun) <= 32


@pytest.fixture(scope="module")
def case():
    return draw_case(CaseSpec("null", (), (), "white", "plays", varied=True), np.random.SeedSequence(4))


def test_the_file_states_a_measured_voltage_and_the_stack_has_the_clean_one(case):
    record, meter = case.records[0], case.voltmeter
    clean_V = record.drive.voltage_V
    error_V = case.recorded_voltage_V(record) - meter.gain * clean_V
    assert np.std(error_V) == pytest.approx(meter.noise_V, rel=0.05)
    assert np.abs(np.corrcoef(error_V[1:], error_V[:-1])[0, 1]) < 0.05
    exact = case.plant.reading_N(record.drive, {}, record.seed) + record.tare_N
    assert np.std(case.reading_N(record) - exact) == pytest.approx(case.noise.rms_N, rel=0.05)
    assert np.mean(case.reading_N(record) - exact) == pytest.approx(0.0, abs=0.05 * case.noise.rms_N + 1e-9)


def test_a_strength_counts_the_noise_of_the_voltmeter(case):
    input_noise_N = case.plant.law.full_N * case.voltmeter.noise_V / case.plant.hysteresis.reach_V
    assert case.truth["input_noise_N"] == pytest.approx(input_noise_N)
    assert case.truth["floor_N"] == pytest.approx(np.hypot(case.noise.rms_N, input_noise_N))


def test_a_load_step_comes_after_the_first_written_sample():
    for seed in range(8):
        spec = CaseSpec("single", ("load_step",), (4.0,), "white", "plays", varied=True)
        drawn = draw_case(spec, np.random.SeedSequence(seed))
        assert drawn.effects["load_step"].parameters["on_s"] >= drawn.records[1].begin_s


def test_the_second_input_scales_the_force_in_steps_and_is_zero_at_zero_force():
    voltage_V = np.concatenate((np.zeros(500), triangles(1.0, 10)))
    plant, given = straight_plant(), drive(voltage_V)
    name, kind = next(iter(SECOND_INPUTS.items()))
    details = {"dwell_s": 0.5, "knee": 0.1}
    added_N = forces(plant, given, **effect(name, details, amount=0.1)) - forces(plant, given)
    assert np.abs(added_N[:500]).max() < 1e-9
    assert added_N.min() >= 0.0
    assert 0.03 * FULL_N < added_N.max() <= 0.1 * FULL_N + 1e-9
    levels = added_N[voltage_V > 0.6 * REACH_V] / FULL_N / 0.1
    assert np.ptp(levels) > 0.4
    assert kind.location == "force"


def test_the_second_input_is_the_answer_of_another_seed_in_another_record():
    context = [ForeignContext(drive(np.zeros(9)), 1e-3, REACH_V, FULL_N, np.random.default_rng(k)) for k in (1, 2)]
    kind, force_N = SECOND_INPUTS["modulating_neighbour"], np.full(5000, FULL_N)
    first, second = (kind.apply(force_N, 0.1, {"dwell_s": 0.5, "knee": 0.1}, each) for each in context)
    assert np.std(first - second) > 0.01 * FULL_N


def test_a_tenth_of_a_varied_plan_is_unrecorded_and_a_usual_plan_has_none():
    varied = case_specs(np.random.default_rng(1), 200, "all", None, None, varied=True)
    assert sum(spec.kind == "unrecorded" for spec in varied) == round(200 * VARIED_SHARES["unrecorded"])
    assert {spec.names for spec in varied if spec.kind == "unrecorded"} == {tuple(SECOND_INPUTS)}
    assert all(spec.varied for spec in varied)
    usual = case_specs(np.random.default_rng(1), 200, "all", None, None)
    assert not any(spec.varied or spec.kind == "unrecorded" for spec in usual)
    assert not set(FOREIGN) & set(SECOND_INPUTS)


def test_a_varied_study_is_sealed_with_its_benches_and_an_unrecorded_input_is_no_name(tmp_path):
    make(tmp_path, 2, seed=5, kind="unrecorded", varied=True)
    for case in read_truth(tmp_path):
        assert case.kind == "unrecorded"
        assert case.foreign == "modulating_neighbour"
        assert case.names == frozenset()
        assert case.tared
    for fields in open_truth(tmp_path)["cases"].values():
        assert {"identification", "work", "voltmeter", "tares_N", "begins_s"} <= set(fields["bench"])


def rounded(value):
    """A truth with six digits of every number: a processor may change the last digits."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


@pytest.mark.parametrize("kind", USUAL_TRUTHS)
def test_a_usual_study_has_the_truth_of_before_varied_benches(tmp_path, kind):
    make(tmp_path, 2, seed=1, kind=kind, families=("plays", "preisach"))
    text = json.dumps(rounded(open_truth(tmp_path)))
    assert hashlib.sha256(text.encode()).hexdigest()[:8] == USUAL_TRUTHS[kind]


def test_a_usual_bench_records_its_commands_and_has_no_tare():
    case = draw_case(CaseSpec("null", (), (), "white", "plays"), np.random.SeedSequence(4))
    record = case.records[0]
    assert (case.recorded_voltage_V(record) == record.drive.voltage_V).all()
    assert {record.tare_N for record in case.records} == {record.begin_s for record in case.records} == {0.0}


def test_the_gap_of_a_tared_record_is_closed_without_its_offset_and_the_noise_of_the_voltmeter():
    rng = np.random.default_rng(1)
    true_N = np.sin(np.arange(20_000) / 20.0)
    error_N, noise_N = 0.5 * np.cos(np.arange(20_000) / 7.0), 0.1 * rng.normal(size=20_000)
    held_out = HeldOut(true_N, true_N + error_N + noise_N + 3.0, true_N + noise_N - 2.0)
    effects = (TrueEffect("creep", {}, (), 4.0, "come_since"),)
    tared = TrueCase("case_0001", "single", effects, "", 0.11, "", 0.1, tared=True)
    assert gap_closed(tared, held_out) == pytest.approx(1.0, abs=0.002)
    usual = TrueCase("case_0001", "single", effects, "", 0.11)
    assert gap_closed(usual, held_out) < 0.6
