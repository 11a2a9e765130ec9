"""Concealed cases: recordings of another plant whose hidden effects are sealed away, and the scoring of what was said.

This plant shares no equation, integrator, time step or creep law with `piezod` nor with the emulated bench: an
oversampled grid, exact linear responses, hysteresis drawn anew for every case, and effects that are in no catalogue.
"""
