"""The search: what was preferred at first does not hide what stands beside it."""

from dataclasses import replace
from time import monotonic

import numpy as np
import pytest
from scipy import signal

from piezod.diagnose.candidates.screening import Screening
from piezod.diagnose.candidates.tones import Tone, reestimated_tones, without_tones
from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.fit import fit
from piezod.diagnose.hypothesis.terms import Term
from piezod.diagnose.selection.candidates import Candidates
from piezod.diagnose.selection.finish import replace_by_rivals
from piezod.diagnose.selection.moves import add_pair, refit_earlier_effects
from piezod.diagnose.selection.search import search
from piezod.diagnose.selection.search_state import Round, Search
from piezod.diagnose.selection.tone_search import update_tones
from piezod.diagnose.verdict.evidence import finding_of
from piezod.diagnose.verdict.extended import stored_parameters
from piezod.effects import EFFECTS
from piezod.model.parameters import EffectValues
from tests.unit.diagnose.residuals import mixed_work, noise, series, time
from tests.unit.diagnose.test_corners import many_plays

SAMPLES, RATE_HZ, NOISE_N = 12_000, 200.0, 0.2


def chain_over(missing_N, temperature_C, there_already_N=np.zeros_like):
    """An identification without, and a recording with what is missing; both with a temperature that rises."""
    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(7), []
    for role in ("identification", "recording"):
        u = (
            mixed_work(seconds)
            if role == "recording"
            else 60.0 - 60.0 * np.cos(0.5 * seconds) * np.cos(0.031 * seconds)
        )
        u = np.clip(u - u[0], 0.0, None)
        force_N = many_plays(u) + NOISE_N * noise(SAMPLES, 0.0, rng)
        force_N += missing_N(seconds) if role == "recording" else there_already_N(seconds)
        made.append(series(seconds, u, force_N, NOISE_N, temperature_C=temperature_C, role=role))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    return chain, empty_point(chain, 1.8, 0.0)


@pytest.mark.slow
def test_a_step_that_goes_again_does_not_hide_a_drift():
    def missing_N(seconds):
        return 0.15 * (temperature_C - 20.0) + 0.8 * ((seconds > 21.0) & (seconds < 33.0))

    temperature_C = 20.0 + 8.0 * (1.0 - np.exp(-time(SAMPLES, RATE_HZ) / 25.0))
    found = search(*chain_over(missing_N, temperature_C), lambda *_: None)
    assert set(found.names) == {"thermal_drift", "load_step"}
    assert found.hypothesis.loss < 1.05


@pytest.mark.slow
def test_a_hum_that_was_there_already_hides_nothing_that_is_a_hundredth_of_it():
    """The drift, 0.4 N, gains 11 % of the loss that it leaves; the least that a steady one must gain is 7 %."""

    def hum_N(seconds):
        return 10.0 * np.sin(2.0 * np.pi * 50.02 * seconds) + np.sin(4.0 * np.pi * 50.02 * seconds + 1.0)

    def missing_N(seconds):
        return 0.05 * (temperature_C - 20.0) + hum_N(seconds + 3.0)

    temperature_C = 20.0 + 8.0 * (1.0 - np.exp(-time(SAMPLES, RATE_HZ) / 25.0))
    found = search(*chain_over(missing_N, temperature_C, hum_N), lambda *_: None)
    assert set(found.names) == {"thermal_drift", "mains_hum"}
    assert found.hypothesis.loss < 1.05
    assert [found.chain.series[tone.number].role for tone in found.tones] == ["recording", "identification"]
    assert len(found.diagnosed_tones) == 1


@pytest.mark.slow
def test_a_start_that_was_estimated_without_an_effect_is_no_part_of_what_the_effect_gains():
    def missing_N(seconds):
        return 0.4 * (temperature_C - 20.0)

    temperature_C = 20.0 + 8.0 * (1.0 - np.exp(-time(SAMPLES, RATE_HZ) / 25.0))
    chain, start = chain_over(missing_N, temperature_C)
    right = fit(chain, (), start).loss
    wrong = chain.like([replace(one, path_V=(80.0, 0.0) if one.role == "recording" else ()) for one in chain.series])
    assert fit(wrong, (), start).loss > 1.5 * right
    found = search(wrong, start, lambda *_: None)
    assert found.names == ("thermal_drift",)
    assert [one.path_V for one in found.chain.series] == [(), ()]
    assert abs(found.base.loss / right - 1.0) < 0.01
    assert found.hypothesis.loss < 1.05


def recordings_late_and_bent():
    """A recording read late by 6 samples, of a bent law; and a way to fit effects to it."""

    def late_and_bent(u):
        late_N = np.concatenate((np.zeros(6), many_plays(u)))[: u.size]
        return late_N - 0.1 * late_N * (late_N / 216.0 - 1.0)

    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(7), []
    for role, stack in (("identification", many_plays), ("recording", late_and_bent)):
        u = mixed_work(seconds)
        u = np.clip(u - u[0], 0.0, None)
        made.append(series(seconds, u, stack(u) + NOISE_N * noise(SAMPLES, 0.0, rng), NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    base = fit(chain, (), empty_point(chain, 1.8, 0.0))

    def with_effects(**values):
        terms = tuple(Term(EFFECTS[name], "since") for name in values)
        return fit(chain, terms, replace(base.point, values=tuple(values.values())))

    return chain, base, with_effects


def test_what_fits_better_beside_all_else_that_was_found_is_swapped_in_and_the_other_is_its_rival():
    chain, base, with_effects = recordings_late_and_bent()
    bent = {"curvature": 0.1, "cubic": 0.0}
    found = with_effects(sensor_filter={"cutoff_Hz": 5.0}, output_nonlinearity=bent)
    early = Round(
        base, with_effects(sensor_filter={"cutoff_Hz": 5.0}), (with_effects(transport_delay={"delay_s": 0.02}),)
    )
    result = replace_by_rivals(Search(chain, base, found, base.point, (early,)))
    assert set(result.hypothesis.effects) == {"output_nonlinearity", "transport_delay"}
    delay = next(v for v in result.hypothesis.point.values if "delay_s" in v)
    assert abs(delay["delay_s"] - 6 / RATE_HZ) < 0.1 / RATE_HZ
    assert result.rivalries["transport_delay"].rivals["sensor_filter"] == found.loss
    assert result.rivalries["transport_delay"].with_effect < found.loss


def sliding(force_N):
    """A guide that holds back up to 1.5 N in front of the load cell: sixteen springs that yield one by one."""
    limits_N, stretched = np.linspace(4.0, 16.0, 16), np.zeros(16)
    held_N = np.empty(force_N.size)
    for k, moved in enumerate(np.diff(force_N, prepend=force_N[0])):
        stretched = np.clip(stretched + moved, -limits_N, limits_N)
        held_N[k] = 1.5 * np.mean(stretched / limits_N)
    return force_N - held_N


def leaning(u):
    """A stack whose wide plays weigh more the higher they stand."""
    places, before = np.zeros(8), many_plays(u)
    radii_V, added_N = np.linspace(4.0, 40.0, 8), np.empty(u.size)
    for k, now in enumerate(u):
        places = np.clip(places, now - radii_V, now + radii_V)
        added_N[k] = 0.3 * np.sum((places - now) * places) / 120.0
    return before + added_N


@pytest.mark.parametrize(
    ("plant", "taken"),
    [(lambda u: sliding(many_plays(u)), "friction"), (leaning, "noncongruent_minor_loops")],
    ids=["friction", "minor loops"],
)
def test_what_bends_to_any_hysteresis_gives_way_to_what_has_a_shape_and_says_nearly_as_much(plant, taken):
    chain, start = worked(np.random.default_rng(3), lambda force_N, u, role: force_N if role[0] == "i" else plant(u))
    base = fit(chain, (), start)

    def with_one(name, values):
        choices = tuple((one.name, one.search.choices[0]) for one in EFFECTS[name].parameters if one.search.choices)
        return fit(chain, (Term(EFFECTS[name], "since", choices=choices),), replace(base.point, values=(values,)))

    weights = [one for one in EFFECTS["noncongruent_minor_loops"].parameters if not one.search.choices]
    loops = with_one("noncongruent_minor_loops", {one.name: one.search.starts[0] for one in weights})
    rubbing = with_one("friction", {"force_N": 1.0, "presliding_N": 10.0, "exponent": 1.5, "closing": 0.7})
    result = replace_by_rivals(Search(chain, base, loops, base.point, (Round(base, loops, (rubbing,)),)))
    assert result.names == (taken,)
    rival = next(iter(finding_of(result, taken).rivals), None)
    assert taken != "friction" or (rival.name == "noncongruent_minor_loops" and rival.separation > 0.15)


def test_an_effect_of_the_hypothesis_is_no_rival_of_another():
    chain, base, with_effects = recordings_late_and_bent()
    delay, bent = {"delay_s": 6 / RATE_HZ}, {"curvature": 0.1, "cubic": 0.0}
    first, second = with_effects(transport_delay=delay), with_effects(output_nonlinearity=bent)
    round_ = Round(base, first, (replace(second, losses=first.losses),))  # as near as can be, before both were found
    found = Search(chain, base, first, base.point, (round_,))
    assert [one.name for one in finding_of(found, "transport_delay").rivals] == ["output_nonlinearity"]
    both = replace(found, hypothesis=with_effects(transport_delay=delay, output_nonlinearity=bent))
    alone = finding_of(both, "transport_delay")
    assert alone.rivals == ()
    assert alone.confidence > 0.8


@pytest.mark.parametrize("vibration_N", [0.0, 3.0])
def test_a_tone_that_was_the_ringing_of_a_mode_is_given_back_to_it(vibration_N):
    """Steps ring at 11 Hz, which is a line; taken off it leaves a mode that is a little beside."""
    seconds, rng, made, mode_Hz, zeta = time(SAMPLES, RATE_HZ), np.random.default_rng(13), [], 11.1, 0.045
    turns = 2.0 * np.pi * mode_Hz
    for role in ("identification", "recording"):
        u = mixed_work(seconds)
        if role == "recording":
            u += 20.0 * (np.floor(seconds / 1.7) % 2)
        u = np.clip(u - u[0], 0.0, None)
        stiff_N = many_plays(u)
        ringing = signal.lsim(([turns**2], [1.0, 2.0 * zeta * turns, turns**2]), stiff_N - stiff_N[0], seconds)[1]
        force_N = stiff_N[0] + ringing + NOISE_N * noise(SAMPLES, 0.0, rng)
        if role == "recording":
            force_N += vibration_N * np.sin(2.0 * np.pi * 11.3 * seconds)
        made.append(series(seconds, u, force_N, NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(140.0), ForceLaw(-4.0, 140.0), 256.0)
    base = fit(chain, (), empty_point(chain, 1.8, 0.0))
    residuals_N = [one.reading_N - chain.run(k, (), base.point).reading_N for k, one in enumerate(chain.series)]
    guess = Tone("vibration", 1, {"frequency_Hz": 11.05}, np.zeros(SAMPLES))
    group = reestimated_tones(chain.series, residuals_N, [guess])
    assert float(np.std(group[0].signal_N)) > NOISE_N
    quiet = chain.like(without_tones(chain.series, group))
    mode = Term(EFFECTS["resonance"], "already")
    start = replace(base.point, values=({"frequency_Hz": 11.3, "damping_ratio": 0.04},))
    result = Search(quiet, fit(quiet, (), base.point), fit(quiet, (mode,), start), base.point, tones=tuple(group))
    result = update_tones(result)
    assert [tone.name for tone in result.diagnosed_tones] == (["vibration"] if vibration_N else [])
    assert result.hypothesis.point.values[0]["frequency_Hz"] == pytest.approx(
        mode_Hz, rel=2e-3 if vibration_N == 0.0 else 0.02
    )
    if vibration_N == 0.0:
        assert result.hypothesis.loss < 1.05


@pytest.mark.slow
def test_a_bessel_filter_of_the_reading_is_one_filter_without_a_rival_that_does_not_ring():
    """Of second order, damping ratio sqrt(3/4): neither a Butterworth filter nor a mode."""
    seconds, rng, made, cutoff_Hz = time(SAMPLES, RATE_HZ), np.random.default_rng(11), [], 6.0
    bessel = signal.bessel(2, 2.0 * np.pi * cutoff_Hz, analog=True, norm="mag")
    for role in ("identification", "recording"):
        u = mixed_work(seconds)
        u = np.clip(u - u[0], 0.0, None)
        force_N = many_plays(u)
        if role == "recording":
            force_N = force_N[0] + signal.lsim(bessel, force_N - force_N[0], seconds)[1]
        made.append(series(seconds, u, force_N + NOISE_N * noise(SAMPLES, 0.0, rng), NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    found = search(chain, empty_point(chain, 1.8, 0.0), lambda *_: None)
    assert found.names == ("sensor_filter",)
    assert abs(found.hypothesis.point.values[0]["cutoff_Hz"] / cutoff_Hz - 1.0) < 0.01
    assert abs(found.hypothesis.point.values[0]["damping_ratio"] - np.sqrt(0.75)) < 0.03
    assert "resonance" not in {one.effects[-1] for round_ in found.rounds for one in round_.others}


@pytest.mark.slow
def test_a_large_step_of_the_load_is_found_in_front_of_a_filter_and_of_a_delay():
    """Its edge shows later than the load has it; and without the block that holds it nothing else tells where it is."""
    seconds, rng, made = time(SAMPLES, RATE_HZ), np.random.default_rng(5), []
    smooth = signal.butter(1, 9.0, fs=RATE_HZ)
    for role in ("identification", "recording"):
        force_N = many_plays(np.clip(mixed_work(seconds) - mixed_work(seconds)[0], 0.0, None))
        if role == "recording":
            force_N += 60.0 * ((seconds >= 12.2) & (seconds < 25.3))
        force_N = np.concatenate((np.full(11, force_N[0]), force_N[:-11]))
        force_N = force_N[0] + signal.lfilter(*smooth, force_N - force_N[0])
        u = np.clip(mixed_work(seconds) - mixed_work(seconds)[0], 0.0, None)
        made.append(series(seconds, u, force_N + NOISE_N * noise(SAMPLES, 0.0, rng), NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    found = search(chain, empty_point(chain, 1.8, 0.0), lambda *_: None)
    assert set(found.names) == {"transport_delay", "sensor_filter", "load_step"}
    step = found.hypothesis.point.values[found.names.index("load_step")]
    assert abs(step["step_N"] - 60.0) < 1.0
    assert abs(step["on_s"] - 12.2) < 0.02
    assert abs(step["off_s"] - 25.3) < 0.02
    skipped = [replace(one, start_s=140.0) for one in found.chain.series]
    later = replace(found, chain=found.chain.like(skipped))
    told = finding_of(later, "load_step").parameters
    assert told["on_s"].low <= told["on_s"].value <= told["on_s"].high
    assert told["on_s"].value == pytest.approx(152.2, abs=0.02)
    assert told["off_s"].value == pytest.approx(165.3, abs=0.02)
    term = later.hypothesis.terms[later.names.index("load_step")]
    stored = stored_parameters(term, step)
    assert (stored["on_s"], stored["off_s"]) == pytest.approx((12.2, 25.3), abs=0.02)  # from its first sample
    step["off_s"] = 1e7
    stored = stored_parameters(term, step)
    EffectValues(name="load_step", parameters=stored, recording="0" * 64)  # never is within the range of the catalogue
    assert "off_s" not in finding_of(later, "load_step").parameters


def candidates_of(state, tried):
    """Candidates of which none is accepted alone."""
    candidates = Candidates(state)
    candidates.tried, candidates.best = tried, None
    return candidates


def worked(rng, missing, drive=None):
    """Identification and recording on the same drive, each with what is missing from it; noise besides."""
    seconds, made = time(SAMPLES, RATE_HZ), []
    u = np.clip(mixed_work(seconds) - mixed_work(seconds)[0], 0.0, None) if drive is None else drive
    for role in ("identification", "recording"):
        force_N = missing(many_plays(u), u, role) + NOISE_N * noise(SAMPLES, 0.0, rng)
        made.append(series(seconds, u, force_N, NOISE_N, role=role))
    chain = Chain(made, PlayDensity.up_to(119.4), ForceLaw(-4.0, 120.0), 216.0)
    return chain, empty_point(chain, 1.8, 0.0)


@pytest.mark.slow
def test_a_vibration_that_was_taken_off_beside_a_larger_effect_is_followed_anew_when_that_is_found():
    def missing(force_N, u, role):
        if role == "identification":
            return force_N
        limit_V, moved = 30.0 / RATE_HZ, [u[0]]  # from a sample to the next
        for wanted in u[1:]:
            moved.append(moved[-1] + np.clip(wanted - moved[-1], -limit_V, limit_V))
        return many_plays(np.array(moved)) + 20.0 * np.sin(2.0 * np.pi * 2.6 * time(SAMPLES, RATE_HZ) + 0.4)

    found = search(*worked(np.random.default_rng(8), missing), lambda *_: None)
    assert set(found.names) == {"slew_limit", "vibration"}
    assert abs(found.tones[0].values["amplitude_N"] - 20.0) < 0.03
    assert found.hypothesis.loss < 1.05


def slipping(force_N, force, presliding_N):
    """Less what a guide takes that sticks for so long and then slips."""
    taken = np.zeros(force_N.size)
    for k in range(1, force_N.size):
        taken[k] = np.clip(taken[k - 1] + (force_N[k] - force_N[k - 1]) * force / presliding_N, -force, force)
    return force_N - taken


@pytest.mark.parametrize("coupled_N_s_per_V", [pytest.param(0.0012, marks=pytest.mark.slow), 0.0])
def test_two_effects_are_found_at_once_where_each_leaves_what_the_other_one_is(coupled_N_s_per_V):
    def missing(force_N, u, role):
        if role == "recording":
            force_N = slipping(force_N, 0.35, 20.0)
        leaking = signal.butter(1, 1.0 / (2.0 * np.pi * 40.0), "high", fs=RATE_HZ)
        read_N = force_N[0] + signal.lfilter(*leaking, force_N - force_N[0])
        if role == "recording":
            read_N[1:] += coupled_N_s_per_V * np.diff(u) * RATE_HZ
        return read_N

    chain, start = worked(np.random.default_rng(3), missing)
    base = fit(chain, (), start)
    leak = fit(
        chain, (Term(EFFECTS["charge_leakage"], "already"),), replace(start, values=({"time_constant_s": 30.0},))
    )
    values = {"force_N": 0.5, "presliding_N": 15.0, "exponent": 1.5, "closing": 0.7}
    terms = (*leak.terms, Term(EFFECTS["friction"], "since"))
    alone = fit(chain, terms, replace(leak.point, values=(*leak.point.values, values)))
    result = Search(chain, base, leak, start)
    result = add_pair(candidates_of(result, [(chain, alone)]))
    assert (result is not None) == (coupled_N_s_per_V > 0.0)
    if result is not None:
        assert result.names == ("charge_leakage", "friction", "feedthrough")
        assert result.hypothesis.loss < 1.05
        assert abs(result.hypothesis.point.values[2]["coefficient_N_s_per_V"] / coupled_N_s_per_V - 1.0) < 0.05


@pytest.mark.parametrize("coupled_N_s_per_V", [0.004, -0.004])
def test_what_adds_so_much_of_either_sign_is_begun_at_its_own_sign_and_size(coupled_N_s_per_V):
    def missing(force_N, u, role):
        if role == "recording":
            force_N[1:] += coupled_N_s_per_V * np.diff(u) * RATE_HZ
        return force_N

    chain, start = worked(np.random.default_rng(6), missing)
    estimates = Screening(chain, (), fit(chain, (), start).point).singles
    begun = [one.candidates[0] for one in estimates if one.name == "feedthrough"]
    assert begun[0].term.scope == "since"
    assert begun[0].values["coefficient_N_s_per_V"] == pytest.approx(coupled_N_s_per_V, rel=0.1)


def test_a_choice_that_was_made_before_another_effect_was_found_is_made_anew():
    """Creep of the stroke that passed for creep of the voltage, and fits badly as such beside its lag."""
    chain, start = chain_over(np.zeros_like, np.full(SAMPLES, 20.0))
    base, lag = fit(chain, (), start), Term(EFFECTS["electrical_lag"], "already")
    of_stroke, of_voltage = ((Term(EFFECTS["creep"], "already", choices=(("driven_by", k),)), lag) for k in (0.0, 1.0))
    creep = {"per_decade": 0.02, "from_s": 0.2, "to_s": 1000.0, "slope": 0.0}
    truth = replace(base.point, values=(creep, {"time_constant_s": 0.03, "swell": 0.0}))
    rng = np.random.default_rng(3)
    readings_N = [chain.run(k, of_stroke, truth).reading_N for k in range(len(chain.series))]
    noisy = [one + NOISE_N * noise(SAMPLES, 0.0, rng) for one in readings_N]
    chain = chain.like([replace(one, reading_N=y) for one, y in zip(chain.series, noisy, strict=True)])
    base = fit(chain, (), base.point)
    begun = ({"per_decade": 0.01, "from_s": 0.1, "to_s": 1000.0, "slope": 0.0}, {"time_constant_s": 0.02, "swell": 0.0})
    early = fit(chain, of_voltage, replace(base.point, values=begun))
    assert early.loss > 1.05
    result = Search(chain, base, early, base.point)
    result = refit_earlier_effects(result)
    assert dict(result.hypothesis.terms[0].choices)["driven_by"] == 0.0
    assert result.hypothesis.loss < 1.02


def test_a_search_whose_time_is_over_takes_no_effect_and_says_so():
    def missing(force_N, u, role):
        return force_N if role == "identification" else force_N * np.linspace(1.0, 1.1, force_N.size)

    chain, start = worked(np.random.default_rng(8), missing)
    steps = []
    found = search(chain, start, lambda step, share: steps.append((step, share)), until_s=monotonic() - 1.0)
    assert found.ended_early
    assert found.names == ()
    assert not found.chain.is_late
    assert found.hypothesis.loss == pytest.approx(fit(found.chain, (), start).loss, rel=0.05)
    assert all(share is None for _, share in steps)


def test_a_fit_whose_time_is_over_stays_at_its_start_and_has_finite_losses():
    chain, start = worked(np.random.default_rng(8), lambda force_N, _u, _role: force_N)
    late = fit(chain.within(monotonic() - 1.0), (), start)
    np.testing.assert_array_equal(late.point.law, start.law)
    assert np.isfinite(late.losses).all()
    assert fit(chain, (), start).loss < late.loss
