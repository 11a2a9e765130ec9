"""The chain of a diagnosis, and the recording that replaces missing identification recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.hypothesis.basis import ForceLaw, PlayDensity
from piezod.diagnose.hypothesis.chain import Chain, empty_point
from piezod.diagnose.hypothesis.terms import Point
from piezod.estimation.recordings.series import Series
from piezod.estimation.recordings.start import starts_at_rest
from piezod.excitation import varying_triangles
from piezod.model import Model, run_chain

SUBSTITUTE = "the model's own simulation"  # name of the recording that replaces missing identification recordings
LOOSE = 10.0
"""Factor on the noise of that recording when further effects are looked for in a bench with known ones.
A base fits each drive to about a noise, not below it. With this factor the gain is known to 1.4 to 3.7 %, as well as
the form of an effect; a fit refines the base before an effect is named for its sake."""
SUBSTITUTE_SAMPLES = 6000  # length of the excitation that replaces missing identification recordings


def substitute_recording(model: Model) -> Series:
    """Recording simulated from the model as identified, which replaces missing identification recordings."""
    peak = model.input.high
    rate_Hz = SUBSTITUTE_SAMPLES / 150.0
    u = varying_triangles(peak - min(model.input.low, 0.0), 0.1, 15, rate_Hz) + min(model.input.low, 0.0)
    time_s = np.arange(u.size) / rate_Hz
    temperature_C = np.zeros(u.size)  # constant; without it no thermal drift is tried
    identified = as_identified(model).model_copy(update={"unnamed_law": None})
    y = run_chain(identified, model.operator(), time_s, u, temperature_C=temperature_C)
    errors = model.provenance.fit
    noise = errors.rms_fit or errors.rms_held_out or 1e-3 * float(np.ptp(y))
    return Series(
        SUBSTITUTE,
        "identification",
        time_s,
        u,
        y,
        np.ones(u.size, bool),
        noise,
        hold=model.hold,
        temperature_C=temperature_C,
    )


def with_loose_base(chain: Chain) -> Chain:
    """Chain in which a recording that replaces missing ones counts less; the chain itself without such a recording."""
    series = [replace(s, noise_N=LOOSE * s.noise_N) if s.name == SUBSTITUTE else s for s in chain.series]
    return chain.like(series) if any(s.name == SUBSTITUTE for s in chain.series) else chain


def with_tight_base(chain: Chain, first: Chain) -> Chain:
    """Chain in which a recording that replaces missing ones counts as in the chain `first`, before it was loosened."""
    noises_N = {s.name: s.noise_N for s in first.series if s.name == SUBSTITUTE}
    series = [replace(s, noise_N=noises_N.get(s.name, s.noise_N)) for s in chain.series]
    return chain.like(series) if noises_N else chain


def as_identified(model: Model) -> Model:
    """Given model without the effects and the law that appeared after its identification."""
    effects = tuple(effect for effect in model.effects if effect.since == "identification")
    law = model.unnamed_law
    kept = law if law is not None and law.since == "identification" else None
    return model.model_copy(update={"effects": effects, "unnamed_law": kept})


def chain_of(series: Sequence[Series], model: Model) -> tuple[Chain, Point]:
    """Chain of the recordings, and the base from which a fit begins."""
    low = min(float(recording.command_V.min()) for recording in series)
    high = max(float(recording.command_V.max()) for recording in series)
    swing = high - low
    may_be_virgin = any(starts_at_rest(recording.command_V) for recording in series)
    reach = 0.995 * (max(abs(low), abs(high)) if may_be_virgin else 0.5 * swing)
    law = ForceLaw(low - 0.03 * swing, high)
    spans = model.output.high - model.output.low, model.input.high - model.input.low
    diagnosed = [recording for recording in series if recording.role == "recording"] or series
    seen_s = model.seen_s or max(recording.duration_s for recording in diagnosed)
    chain = Chain(series, PlayDensity.up_to(reach), law, spans[0], voltage_span_V=spans[1], seen_s=seen_s)
    gain = spans[0] / spans[1]
    return chain, empty_point(chain, gain, model.output.low - gain * model.input.low)
