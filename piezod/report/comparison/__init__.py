"""Model against measurement: simulated and measured outputs, and the whiteness test of a residual."""
