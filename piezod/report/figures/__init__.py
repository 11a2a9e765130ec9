"""Figures that several pages share: their layout, thinned curves, histograms of durations, and their data as CSV."""
