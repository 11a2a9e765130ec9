"""Settings that every test shares."""

from hypothesis import settings

settings.register_profile("piezod", deadline=None)  # timing is a benchmark, never an assertion
settings.load_profile("piezod")
