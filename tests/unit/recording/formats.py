"""Every file format of recordings, and which of them this environment can read."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from piezod.recording import Recording

PACKAGES = {".csv": "", ".h5": "h5py", ".hdf5": "h5py", ".mat": "", ".tdms": "nptdms"}
PACKAGES |= {".parquet": "pyarrow", ".mf4": "asammdf", ".sqlite": ""}

REAL = Path(__file__).resolve().parents[4] / "shared" / "recordings"


def suffixes(*wanted):
    """Test parameters for these suffixes, or for all if none is given; skipped without the package of the format."""
    return [
        pytest.param(
            suffix,
            marks=pytest.mark.skipif(
                bool(package) and importlib.util.find_spec(package) is None, reason=f"{package} is not installed"
            ),
        )
        for suffix, package in PACKAGES.items()
        if not wanted or suffix in wanted
    ]


def sample(n=300, seed=1):
    rng = np.random.default_rng(seed)
    channels = {"voltage_V": rng.normal(size=n) * 50, "force_N": rng.normal(size=n) * 100, "slew_V_per_s": np.ones(n)}
    return Recording(np.arange(n) * 1e-3, channels, {"bench": "a & <b>", "operator": "µ"})


def same(first, second):
    assert list(first.channels) == list(second.channels)
    np.testing.assert_array_equal(first.time_s, second.time_s)
    for name, values in first.channels.items():
        np.testing.assert_array_equal(values, second.channels[name])


@st.composite
def recordings(draw):
    """Any recording whose channel names every format can store; values and missing samples are arbitrary."""
    n = draw(st.integers(1, 20))
    periods = draw(arrays(float, n, elements=st.floats(1e-6, 1e3)))
    names = draw(st.lists(st.from_regex(r"[a-z]{1,6}_[A-Z]{1,2}", fullmatch=True), min_size=1, max_size=4, unique=True))
    channels = {name: draw(arrays(float, n, elements=st.floats(width=64))) for name in names}
    text = st.text(st.characters(codec="utf-8", categories=["L", "N"]), min_size=1, max_size=8)
    metadata = draw(st.dictionaries(text, text, max_size=3))
    return Recording(np.cumsum(periods), channels, metadata)
