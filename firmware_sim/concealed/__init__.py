"""Concealed cases: recordings of a second plant with sealed effects, and the scoring of a diagnosis against them.

The plant shares no equation, integrator, time step or creep law with `piezod` or with the emulated bench. It uses an
oversampled grid and exact linear responses. Every case draws its own hysteresis. Some effects are in no catalogue.
"""
